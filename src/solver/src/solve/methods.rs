//! Solving a constrained system: arguments, groups of columns, the choice of method.

use crate::build::hierarchy::Hierarchy;
use crate::constrain::system::LinearSystem;
use crate::error::Error;
use crate::lanes::{NO_ROW, WIDTH, WideLanes, per_lane, ratio};
use crate::options::{InitialGuess, SolveMethod, SolveOptions, SolveStats};
use crate::solve::advance::rhs_reference_norms;
use crate::solve::cycle::MultigridCycle;
use crate::solve::group::{
    GroupOutcome, GroupSolve, IterationReport, IterationWatcher, SolutionSnapshot, SolveControl, StoppingCriteria,
    Workspace,
};
use crate::solve::problem::{ColumnGroup, LinearEquations};
use crate::solve::start::{StartMaps, full_multigrid};
use crate::threads::Parallelism;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;

/// Refinements of the direct method at most.
const REFINEMENTS: usize = 4;

impl LinearSystem {
    /// The equations with right-hand sides `rhs`: row-major, vertices × `columns`, not read where vertices are fixed.
    /// `hierarchy` is the system's own. Nothing is checked before the equations are used.
    pub fn equations<'a>(&'a self, hierarchy: &'a Hierarchy, columns: usize, rhs: &'a [f64]) -> LinearEquations<'a> {
        LinearEquations {
            system: self,
            hierarchy,
            columns,
            rhs,
        }
    }
}

impl LinearEquations<'_> {
    /// Solves, for every free vertex i and every column,
    ///
    /// Σ_j w_ij (x_i − x_j) + stiffness_i x_i = rhs_i,
    ///
    /// where x_j of a fixed neighbour is the value that `x` gives it.
    ///
    /// `x` is row-major, vertices × columns. Fixed rows of `x` are never written; free rows are the start (with
    /// [`InitialGuess::Given`]) and receive the solution. `watch` is called after every iteration, from the calling
    /// thread. At least one iteration is done unless the start is exact, so that every result has an error estimate.
    ///
    /// A component with neither fixed vertex nor stiffness determines its values up to a constant: its right-hand
    /// side is projected to sum zero, and the mean of its start is kept (with starts other than `Given`: 0).
    ///
    /// If the criteria are not reached (`max_iterations`, or rounding) the best solution is in `x` and
    /// [`SolveStats::converged`] is false, without an error.
    ///
    /// # Errors
    /// [`Error::Invalid`] for lengths that do not fit, numbers that are not finite, or another hierarchy's system;
    /// [`Error::Cancelled`], checked between sweeps; [`Error::Diverged`] if nothing finite came out. Free rows of `x`
    /// may then hold solutions of some columns; they stay finite.
    pub fn solve(
        &self,
        x: &mut [f64],
        options: &SolveOptions<'_>,
        workspace: &mut Workspace,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&IterationReport<'_>) -> SolveControl,
    ) -> Result<SolveStats, Error> {
        let Self { system, columns, .. } = *self;
        self.check(x.len())?;
        check_options(self.hierarchy, columns, options)?;
        exec.check()?;
        exec.progress.begin_pass("load");
        let mut stats = SolveStats {
            iterations: 0,
            residual: 0.0,
            residuals: Vec::with_capacity(columns),
            max_error: 0.0,
            factor: 0.0,
            method: SolveMethod::Trivial,
            stopped: false,
            converged: true,
        };
        if system.free_count() == 0 {
            stats.residuals.resize(columns, 0.0);
            return Ok(stats);
        }
        let groups = columns.div_ceil(WIDTH);
        let criteria = StoppingCriteria {
            tolerance: options.tolerance,
            // The groups' errors add up as a vector.
            max_error: options.max_error.map(|e| e / (groups.max(1) as f64).sqrt()),
            max_iterations: options.max_iterations,
        };
        for first in (0..columns).step_by(WIDTH) {
            let given = matches!(options.start, InitialGuess::Given);
            let threads = Parallelism::from_pool(exec.pool);
            let problem = threads.run_on(exec.pool, || {
                ColumnGroup::new(self, first, x, given, threads)
                    .inspect(|problem| problem.load(x, given, &mut workspace.x))
            })?;
            let outcome = if system.is_direct() {
                solve_directly(&problem, criteria, workspace, x, exec, watch)?
            } else {
                let cycle = MultigridCycle {
                    hierarchy: self.hierarchy,
                    system,
                    threads,
                    progress: exec.progress,
                };
                let group = GroupSolve {
                    problem,
                    cycle,
                    pool: exec.pool,
                    criteria,
                    workspace,
                    caller: x,
                    from_zero: matches!(options.start, InitialGuess::Zero),
                    recalled: None,
                    reached: None,
                    left: None,
                };
                solve_by_cycles(group, options.start, watch)?
            };
            exec.progress.begin_pass("store");
            problem.store(&workspace.x, None, x);
            merge_outcome(&mut stats, &outcome, problem.width());
            if outcome.stopped {
                break;
            }
        }
        // Columns that were not reached because the caller stopped.
        if stats.residuals.len() < columns {
            let rest = self.residual(x, None, exec.pool)?;
            let known = stats.residuals.len();
            stats.residuals.extend_from_slice(&rest[known..]);
            stats.converged = false;
        }
        stats.residual = stats.residuals.iter().fold(0.0, |a, &b| a.max(b));
        Ok(stats)
    }

    /// The true relative residual ‖b − A x‖₂ / ‖b‖₂ per column, computed in double precision from the equations
    /// alone. With `rows`, also b − A x itself, in the shape of `x`, 0 on fixed rows.
    ///
    /// Components that nothing holds are judged as [`LinearEquations::solve`] solves them, without their mean. A column whose
    /// b is 0 gives 0 if its residual is 0, else infinity.
    ///
    /// ```
    /// # use pliant_exec::{Exec, pool::Pool, progress::Silent};
    /// # use pliant_solver::{BuildOptions, Constraints, Hierarchy, WeightedGraph};
    /// # let pool = Pool::new(1)?;
    /// # let exec = Exec::new(&pool, &Silent);
    /// # let chain = WeightedGraph { offsets: &[0, 1, 3, 5, 7, 8], neighbours: &[1, 0, 2, 1, 3, 2, 4, 3], weights: None, positions: None };
    /// let hierarchy = Hierarchy::build(&chain, &BuildOptions::default(), &exec)?;
    /// let ends = Constraints { fixed: &[true, false, false, false, true], stiffness: None };
    /// let system = hierarchy.constrain(&ends, &pool)?;
    /// let equations = system.equations(&hierarchy, 1, &[0.0; 5]);
    /// let relative = equations.residual(&[0.0, 1.0, 2.0, 3.0, 4.0], None, &pool)?;
    /// assert!(relative[0] < 1e-12, "a straight line is harmonic");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Invalid`] as for [`LinearEquations::solve`].
    pub fn residual(&self, x: &[f64], rows: Option<&mut [f64]>, pool: &Pool) -> Result<Vec<f64>, Error> {
        let Self { hierarchy, columns, .. } = *self;
        self.check(x.len())?;
        let mut rows = rows;
        if let Some(out) = rows.as_deref_mut() {
            check_lengths(hierarchy, columns, self.rhs.len(), out.len())?;
            out.fill(0.0);
        }
        let threads = Parallelism::from_pool(pool);
        let n = hierarchy.levels[0].rows();
        let (mut values, mut r) = (Vec::new(), vec![[0.0; WIDTH]; n]);
        let mut relative = Vec::with_capacity(columns);
        for first in (0..columns).step_by(WIDTH) {
            let (problem, norms, reference) = threads.run_on(pool, || -> Result<_, Error> {
                let problem = ColumnGroup::new(self, first, x, true, threads)?;
                problem.load(x, true, &mut values);
                r.fill([0.0; WIDTH]);
                let norms = problem.wide_residual(&values, &mut r);
                let reference = rhs_reference_norms(&problem, &values);
                Ok((problem, norms, reference))
            })?;
            for c in 0..problem.width() {
                let norm = norms[c].sqrt();
                relative.push(if norm == 0.0 { 0.0 } else { norm / reference[c] });
                if let Some(out) = rows.as_deref_mut() {
                    for (r, &v) in r.iter().zip(&hierarchy.order).filter(|(_, v)| **v != NO_ROW) {
                        out[v as usize * columns + first + c] = problem.outer_residual(r[c], c);
                    }
                }
            }
        }
        Ok(relative)
    }

    /// Checks that the hierarchy is the system's and that right-hand side and solution have its lengths.
    fn check(&self, solution: usize) -> Result<(), Error> {
        self.system.check_hierarchy(self.hierarchy)?;
        check_lengths(self.hierarchy, self.columns, self.rhs.len(), solution)
    }
}

fn check_lengths(hierarchy: &Hierarchy, columns: usize, rhs: usize, x: usize) -> Result<(), Error> {
    let n = hierarchy.vertices();
    match n.checked_mul(columns) {
        Some(want) if want == rhs && want == x => Ok(()),
        _ => Err(Error::Invalid(format!(
            "right-hand side of {rhs} and solution of {x} numbers for {n} vertices and {columns} columns"
        ))),
    }
}

fn check_options(hierarchy: &Hierarchy, columns: usize, options: &SolveOptions<'_>) -> Result<(), Error> {
    let n = hierarchy.vertices();
    for (value, name) in [(options.tolerance, "tolerance"), (options.max_error, "max_error")] {
        if let Some(v) = value.filter(|v| !(*v > 0.0 && v.is_finite())) {
            return Err(Error::Invalid(format!("{name} is {v}, it must be positive")));
        }
    }
    let InitialGuess::FullMultigrid { frames, rest } = options.start else {
        return Ok(());
    };
    let Some(frames) = frames else { return Ok(()) };
    if columns != 3 {
        return Err(Error::Invalid(format!("frames are for 3 columns, there are {columns}")));
    }
    if frames.len() != n || rest.is_some_and(|r| r.len() != n) {
        let (f, r) = (frames.len(), rest.map_or(n, <[_]>::len));
        return Err(Error::Invalid(format!(
            "{f} frames and {r} rest positions for {n} vertices"
        )));
    }
    if rest.is_none() && hierarchy.levels[0].positions.is_empty() {
        return Err(Error::Invalid(
            "frames need rest positions, the hierarchy was built without".into(),
        ));
    }
    let finite = frames.iter().all(|f| f.iter().all(|v| v.is_finite()));
    if !finite || rest.is_some_and(|r| r.iter().any(|p| p.iter().any(|v| !v.is_finite()))) {
        return Err(Error::Invalid("frames and rest positions must be finite".into()));
    }
    Ok(())
}

fn merge_outcome(stats: &mut SolveStats, outcome: &GroupOutcome, width: usize) {
    stats.iterations = stats.iterations.max(outcome.iterations);
    stats.residuals.extend_from_slice(&outcome.relative[..width]);
    stats.max_error = libm::hypot(stats.max_error, outcome.max_error);
    stats.factor = stats.factor.max(outcome.factor);
    stats.method = stats.method.max(outcome.method);
    stats.stopped |= outcome.stopped;
    stats.converged &= outcome.converged;
}

/// Iterates on one group of columns, from full multigrid where that is the start, by this solver's cycles or by the paper's.
fn solve_by_cycles(
    mut group: GroupSolve<'_, '_>,
    start: InitialGuess<'_>,
    watch: &mut IterationWatcher<'_>,
) -> Result<GroupOutcome, Error> {
    let problem = group.problem;
    if let Some(paper) = &problem.system.paper {
        return crate::paper::solve(&mut group, paper, start, watch);
    }
    if let InitialGuess::FullMultigrid { frames, rest } = start {
        group.cycle.progress.begin_pass("start");
        let GroupSolve {
            cycle, pool, workspace, ..
        } = &mut group;
        problem.threads.run_on(pool, || {
            full_multigrid(&problem, cycle, StartMaps::ByVertex(frames, rest), workspace, None)
        })?;
    }
    group.solve(watch)
}

/// Few free vertices: the dense inverse, refined until the residual is as small as asked.
fn solve_directly(
    problem: &ColumnGroup<'_>,
    criteria: StoppingCriteria,
    workspace: &mut Workspace,
    caller: &[f64],
    exec: &Exec<'_>,
    watch: &mut IterationWatcher<'_>,
) -> Result<GroupOutcome, Error> {
    let Workspace {
        x,
        wide: [r, gathered, z],
        ..
    } = workspace;
    let (threads, width, system) = (problem.threads, problem.width(), problem.system);
    r.resize(x.len(), [0.0; WIDTH]);
    let mut reference = threads.run_on(exec.pool, || rhs_reference_norms(problem, x));
    let unit = problem.unit;
    let mut outcome = GroupOutcome::new(SolveMethod::Direct);
    loop {
        exec.check()?;
        let norms = threads.run_on(exec.pool, || problem.wide_residual(x, r));
        if norms.iter().any(|v| !v.is_finite()) {
            return Err(Error::Diverged {
                iterations: outcome.iterations,
                residual: f64::INFINITY,
            });
        }
        for c in 0..WIDTH {
            if reference[c] == 0.0 {
                reference[c] = norms[c].sqrt();
            }
        }
        outcome.relative = per_lane(|c| ratio(norms[c].sqrt(), reference[c]));
        // The inverse turns the residual into the error itself.
        gathered.clear();
        gathered.extend(system.dense_rows.iter().map(|&i| r[i as usize]));
        z.clear();
        z.extend((0..system.inverse.size()).map(|k| system.inverse.row_times(k, gathered)));
        let length = |z: &WideLanes| (0..WIDTH).map(|c| (z[c] * unit[c]).powi(2)).sum::<f64>().sqrt();
        outcome.max_error = z.iter().map(length).fold(0.0, f64::max);
        outcome.converged = criteria.hold(&outcome.relative[..width], outcome.max_error);
        if outcome.iterations > 0 {
            let iteration = IterationReport {
                index: outcome.iterations,
                columns: problem.columns(),
                residual: outcome.relative[..width].iter().fold(0.0, |a, &b| a.max(b)),
                max_error: outcome.max_error,
                snapshot: SolutionSnapshot {
                    problem: *problem,
                    x,
                    e: None,
                    caller,
                },
            };
            outcome.stopped = watch(&iteration) == SolveControl::Stop;
        }
        let exact = norms.iter().all(|v| *v == 0.0);
        let most = REFINEMENTS.min(criteria.max_iterations);
        if outcome.stopped || exact || outcome.iterations >= most || (outcome.converged && outcome.iterations > 0) {
            outcome.converged |= exact;
            return Ok(outcome);
        }
        for (&i, z) in system.dense_rows.iter().zip(&*z) {
            for c in 0..WIDTH {
                x[i as usize][c] += z[c];
            }
        }
        outcome.iterations += 1;
    }
}
