//! Cycles until the criteria hold, and what happens when they never would.
//!
//! A cycle is Algorithm 1 with γ = 1, a V-cycle on the defect equations. Full multigrid (figure 4) restricts the original
//! equations to the coarsest level, solves them there and prolongs the solution.

use crate::error::Error;
use crate::lanes::{WIDTH, WideLanes, per_lane, ratio};
use crate::options::{InitialGuess, SolveMethod};
use crate::paper::hierarchy::PaperHierarchy;
use crate::paper::restrict::{
    EdgeOffsets, OperatorReading, add, add_correction_from, prolong, restrict_defect, restricted_constants,
};
use crate::paper::smooth::{ConjugateSteps, defect, sweep};
use crate::solve::advance::rhs_reference_norms;
use crate::solve::fallback::conjugate_gradients;
use crate::solve::group::{
    GroupOutcome, GroupSolve, IterationReport, IterationWatcher, SolutionSnapshot, SolveControl,
};
use pliant_exec::progress::{Cancelled, Progress, check};

/// Cycles that must at least halve the residual.
const PATIENCE: usize = 12;
/// A residual this many times the best one grows.
const GROWN: f64 = 10.0;
/// Bounds of the reduction per cycle that error estimates assume.
const SLOW: (f64, f64) = (0.99, 0.995);
/// Residual below which nothing can be gained in double precision.
const FLOOR: f64 = 1e-14;
/// Conjugate-gradient steps after each cycle that the paper recommends, and the tolerance from which on it does.
const STEPS: (usize, f64) = (2, 1e-5);

/// Iterates on `outer.workspace.x` from the values it holds, or from full multigrid.
///
/// Unlike the rest of the solver it allocates new vectors.
pub(crate) fn solve(
    outer: &mut GroupSolve<'_, '_>,
    paper: &PaperHierarchy,
    start: InitialGuess<'_>,
    watch: &mut IterationWatcher<'_>,
) -> Result<GroupOutcome, Error> {
    let (problem, pool, criteria) = (outer.problem, outer.pool, outer.criteria);
    let mut state = PaperIteration {
        paper,
        levels: vectors(paper),
        conjugate: ConjugateSteps::new(paper.steps.unwrap_or(match criteria.tolerance {
            Some(t) if t <= STEPS.1 => STEPS.0,
            _ => 0,
        })),
        reference: problem
            .threads
            .run_on(pool, || rhs_reference_norms(&problem, &outer.workspace.x)),
        outcome: GroupOutcome::new(SolveMethod::PaperCycles),
        history: CycleHistory::default(),
        beginning: None,
    };
    if let (InitialGuess::FullMultigrid { frames, rest }, true) = (start, paper.usable) {
        let framed = frames.map(|frames| FrameOffsets {
            vertices: &paper.vertices,
            frames,
            rest: rest.unwrap_or(&paper.uncut.positions),
            unit: problem.unit,
        });
        state.begin_with_full_multigrid(outer, framed.as_ref())?;
    }
    loop {
        let worst = state.judge_residual(outer)?;
        let outcome = &state.outcome;
        if outcome.iterations > 0 && state.show_iteration(outer, worst, watch) == SolveControl::Stop {
            state.outcome.stopped = true;
        }
        let outcome = state.outcome;
        if outcome.converged || outcome.stopped || outcome.iterations >= criteria.max_iterations {
            return Ok(outcome);
        }
        let left = criteria.max_iterations - outcome.iterations;
        let history = &state.history;
        let cycles_help = paper.usable && !history.fails() && !history.is_late(criteria.tolerance, left);
        if !cycles_help || !state.advance(outer)? {
            return conjugate_gradients(outer, state.reference, outcome, watch);
        }
    }
}

/// The state of an iteration with the paper's cycles.
struct PaperIteration<'a> {
    paper: &'a PaperHierarchy,
    /// Vectors of the levels, finest first.
    levels: Vec<PaperVectors>,
    /// The conjugate-gradient steps after each cycle.
    conjugate: ConjugateSteps,
    /// Norms of b, which residuals are relative to.
    reference: WideLanes,
    outcome: GroupOutcome,
    history: CycleHistory,
    /// Relative residual before the first cycle.
    beginning: Option<f64>,
}

impl PaperIteration<'_> {
    /// Makes the start by full multigrid from x, which is 0 on free rows.
    fn begin_with_full_multigrid(
        &mut self,
        outer: &mut GroupSolve<'_, '_>,
        framed: Option<&FrameOffsets<'_>>,
    ) -> Result<(), Cancelled> {
        let (paper, problem, progress) = (self.paper, outer.problem, outer.cycle.progress);
        let [r, ..] = &mut outer.workspace.wide;
        let x = &mut outer.workspace.x;
        r.resize(x.len(), [0.0; WIDTH]);
        // x is 0 on free rows, so that this is b.
        problem.threads.run_on(outer.pool, || problem.wide_residual(x, r));
        gather(paper, r, &mut self.levels[0].b);
        match framed {
            Some(framed) => paper.full_multigrid(framed, &mut self.levels, progress)?,
            None => paper.full_multigrid(&ZeroOffsets, &mut self.levels, progress)?,
        }
        // Frames of absurd size can overflow; then 0 is the better start.
        if all_finite(&self.levels[0].x) {
            scatter_rows(paper, &self.levels[0].x, x);
            problem.system.floating.remove_wide_means(x);
        }
        Ok(())
    }

    /// Computes the true residual and compares it with what is asked for. Returns that of the worst column.
    fn judge_residual(&mut self, outer: &mut GroupSolve<'_, '_>) -> Result<f64, Error> {
        let (problem, outcome) = (outer.problem, &mut self.outcome);
        let x = &outer.workspace.x;
        let [r, ..] = &mut outer.workspace.wide;
        r.resize(x.len(), [0.0; WIDTH]);
        let norms = problem.threads.run_on(outer.pool, || problem.wide_residual(x, r));
        if norms.iter().any(|v| !v.is_finite()) {
            return Err(Error::Diverged {
                iterations: outcome.iterations,
                residual: f64::INFINITY,
            });
        }
        for c in 0..WIDTH {
            if self.reference[c] == 0.0 {
                self.reference[c] = norms[c].sqrt();
            }
        }
        outcome.relative = per_lane(|c| ratio(norms[c].sqrt(), self.reference[c]));
        let worst = outcome.relative.iter().fold(0.0f64, |a, &b| a.max(b));
        let from = *self.beginning.get_or_insert(worst);
        self.history.residuals.push(worst);
        let exact = worst <= FLOOR;
        if outcome.iterations == 0 {
            outcome.max_error = if exact { 0.0 } else { f64::INFINITY };
        } else {
            outcome.max_error = self.history.estimate();
            outcome.factor = libm::pow(ratio(worst, from), 1.0 / outcome.iterations as f64);
        }
        let relative = &outcome.relative[..problem.width()];
        let holds = outcome.iterations > 0 && outer.criteria.hold(relative, outcome.max_error);
        outcome.converged = exact || holds;
        Ok(worst)
    }

    /// Shows the caller where the solve stands.
    fn show_iteration(&self, outer: &GroupSolve<'_, '_>, worst: f64, watch: &mut IterationWatcher<'_>) -> SolveControl {
        watch(&IterationReport {
            index: self.outcome.iterations,
            columns: outer.problem.columns(),
            residual: worst,
            max_error: self.outcome.max_error,
            snapshot: SolutionSnapshot {
                problem: outer.problem,
                x: &outer.workspace.x,
                e: None,
                caller: outer.caller,
            },
        })
    }

    /// One cycle and the conjugate-gradient steps after it, from the residual in the workspace. False if the step was not
    /// finite and x is what it was.
    fn advance(&mut self, outer: &mut GroupSolve<'_, '_>) -> Result<bool, Cancelled> {
        let (paper, problem, progress) = (self.paper, outer.problem, outer.cycle.progress);
        // The cycle is linear, so that improving x for b is improving 0 for the defect.
        let finest = &mut self.levels[0];
        gather(paper, &outer.workspace.wide[0], &mut finest.b);
        finest.x.fill([0.0; WIDTH]);
        paper.cycle(0, &mut self.levels, progress)?;
        let finest = &mut self.levels[0];
        let (level, equations) = (&paper.levels[0], &paper.chains[0][0]);
        self.conjugate
            .run(level, equations, &finest.b, &mut finest.x, progress)?;
        if !all_finite(&finest.x) {
            return Ok(false);
        }
        self.history.steps.push(longest(&finest.x, problem.unit));
        let x = &mut outer.workspace.x;
        for (&row, e) in paper.rows.iter().zip(&finest.x) {
            for c in 0..WIDTH {
                x[row as usize][c] += e[c];
            }
        }
        problem.system.floating.remove_wide_means(x);
        self.outcome.iterations += 1;
        Ok(true)
    }
}

/// Values of the finest level's vertices from those in row order.
fn gather(paper: &PaperHierarchy, rows: &[WideLanes], out: &mut [WideLanes]) {
    for (&row, out) in paper.rows.iter().zip(out) {
        *out = rows[row as usize];
    }
}

fn scatter_rows(paper: &PaperHierarchy, values: &[WideLanes], rows: &mut [WideLanes]) {
    for (&row, v) in paper.rows.iter().zip(values) {
        rows[row as usize] = *v;
    }
}

fn all_finite(x: &[WideLanes]) -> bool {
    x.iter().flatten().all(|v| v.is_finite())
}

/// The longest row of a step, in the caller's units.
fn longest(e: &[WideLanes], unit: WideLanes) -> f64 {
    let square = |e: &WideLanes| (0..WIDTH).map(|c| (e[c] * unit[c]).powi(2)).sum::<f64>();
    e.iter().map(square).fold(0.0, f64::max).sqrt()
}

/// How residuals and steps went.
#[derive(Debug, Default)]
struct CycleHistory {
    residuals: Vec<f64>,
    steps: Vec<f64>,
}

impl CycleHistory {
    /// True if cycles have become useless.
    fn fails(&self) -> bool {
        let Some((&last, before)) = self.residuals.split_last() else {
            return false;
        };
        let best = before.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        let slow = before.len() >= PATIENCE && last > 0.5 * before[before.len() - PATIENCE];
        slow || last > GROWN * best
    }

    /// True if cycles go on as before and do not reach `tolerance` within the `left` ones.
    fn is_late(&self, tolerance: Option<f64>, left: usize) -> bool {
        let (Some(tolerance), [.., last]) = (tolerance, self.residuals.as_slice()) else {
            return false;
        };
        let Some(before) = self.residuals.len().checked_sub(1 + PATIENCE) else {
            return false;
        };
        let exponent = left as f64 / PATIENCE as f64;
        last * libm::pow(ratio(*last, self.residuals[before]), exponent) > tolerance
    }

    /// Distance to the solution after the last step: what later steps would move, each ρ times as far as the one before.
    /// ρ is the last reduction of residual or step, whichever was slower.
    fn estimate(&self) -> f64 {
        let reduction = |v: &[f64]| match v {
            [.., a, b] => ratio(*b, *a),
            _ => 0.0,
        };
        let rho = reduction(&self.residuals)
            .max(reduction(&self.steps))
            .clamp(SLOW.0, SLOW.1);
        self.steps.last().map_or(f64::INFINITY, |step| step * rho / (1.0 - rho))
    }
}

/// d of the finest level, ½ (F_i + F_j) (p_i − p_j) per unit of the columns; equation (6) in terms of the linear maps F.
pub(super) struct FrameOffsets<'a> {
    /// Vertex of the caller's arrays for each vertex of the level.
    pub(super) vertices: &'a [u32],
    pub(super) frames: &'a [[f32; 9]],
    pub(super) rest: &'a [[f64; 3]],
    pub(super) unit: WideLanes,
}

impl EdgeOffsets for FrameOffsets<'_> {
    fn d(&self, _: usize, i: usize, j: usize) -> WideLanes {
        let (i, j) = (self.vertices[i] as usize, self.vertices[j] as usize);
        let (f, g) = (&self.frames[i], &self.frames[j]);
        let v: [f64; 3] = std::array::from_fn(|c| self.rest[i][c] - self.rest[j][c]);
        let mut d = [0.0; WIDTH];
        for row in 0..3 {
            let at = |column: usize| f64::from(f[3 * column + row]) + f64::from(g[3 * column + row]);
            d[row] = 0.5 * (at(0) * v[0] + at(1) * v[1] + at(2) * v[2]) / self.unit[row];
        }
        d
    }
}

/// d of a coarser level, one per entry.
struct StoredOffsets(Vec<WideLanes>);

impl EdgeOffsets for StoredOffsets {
    fn d(&self, e: usize, _: usize, _: usize) -> WideLanes {
        self.0[e]
    }
}

/// No d: each vertex wants to lie where its neighbours do, as in the Laplace equation (1).
pub(super) struct ZeroOffsets;

impl EdgeOffsets for ZeroOffsets {
    fn d(&self, _: usize, _: usize, _: usize) -> WideLanes {
        [0.0; WIDTH]
    }
}

impl PaperHierarchy {
    /// Leaves a first solution of the finest equations in `vectors[0].x`, whose right-hand side b is in `vectors[0].b`:
    /// restricts β and d to the coarsest level, solves there, and on the way back prolongs by (14), with one V-cycle on
    /// every level in between. The finest level's own cycles are the caller's.
    pub(super) fn full_multigrid(
        &self,
        finest: &dyn EdgeOffsets,
        vectors: &mut [PaperVectors],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let last = self.levels.len() - 1;
        let mut betas = vec![self.with_offsets(0, finest, -1.0, &vectors[0].b)];
        let mut stored: Vec<StoredOffsets> = Vec::new();
        for l in 0..last {
            let offsets: &dyn EdgeOffsets = if l == 0 { finest } else { &stored[l - 1] };
            let (beta, d) = restricted_constants(
                &self.levels[l],
                &self.chains[l][0],
                &betas[l],
                offsets,
                &self.levels[l + 1],
                &self.chains[l + 1][0],
            );
            stored.push(StoredOffsets(d));
            vectors[l + 1].b = self.with_offsets(l + 1, &stored[l], 1.0, &beta);
            betas.push(beta);
        }
        self.solve_coarsest(last, &mut vectors[last]);
        for l in (0..last).rev() {
            let (fine, coarse) = vectors.split_at_mut(l + 1);
            let offsets: &dyn EdgeOffsets = if l == 0 { finest } else { &stored[l - 1] };
            prolong(
                &self.levels[l],
                &self.chains[l][0],
                &betas[l],
                offsets,
                &coarse[0].x,
                &mut fine[l].x,
            );
            if l > 0 {
                // The cycle overwrites the vectors below, which have served.
                self.cycle(l, &mut vectors[l..], progress)?;
            }
        }
        Ok(())
    }

    /// v_i + sign · Σ_j w_ij d_ji on level `l`: from β to b and back.
    fn with_offsets(&self, l: usize, offsets: &dyn EdgeOffsets, sign: f64, v: &[WideLanes]) -> Vec<WideLanes> {
        let (level, equations) = (&self.levels[l], &self.chains[l][0]);
        let mut out = v.to_vec();
        for (i, out) in out.iter_mut().enumerate() {
            for (e, j) in level.edges(i) {
                add(out, sign * equations.weights[e], offsets.d(e, i, j));
            }
        }
        out
    }
}

/// Sweeps before and after the coarse correction (section 6).
const SWEEPS: usize = 2;

/// Vectors of one level.
#[derive(Debug, Default)]
pub(super) struct PaperVectors {
    pub(super) b: Vec<WideLanes>,
    pub(super) x: Vec<WideLanes>,
    defect: Vec<WideLanes>,
}

/// Vectors of all levels, finest first.
pub(super) fn vectors(paper: &PaperHierarchy) -> Vec<PaperVectors> {
    let vectors = |n: usize| PaperVectors {
        b: vec![[0.0; WIDTH]; n],
        x: vec![[0.0; WIDTH]; n],
        defect: vec![[0.0; WIDTH]; n],
    };
    paper.levels.iter().map(|l| vectors(l.vertices())).collect()
}

impl PaperHierarchy {
    /// One V(2,2) cycle on the original equations of level `s`: improves `vectors[0].x` for `vectors[0].b`. `vectors`
    /// begins at that level.
    pub(super) fn cycle(
        &self,
        s: usize,
        vectors: &mut [PaperVectors],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        self.descend(s, 0, OperatorReading::Held, vectors, progress)
    }

    /// The same on step `k` of chain `s`.
    pub(super) fn descend(
        &self,
        s: usize,
        k: usize,
        reading: OperatorReading,
        vectors: &mut [PaperVectors],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let Some((here, below)) = vectors.split_first_mut() else {
            return Ok(());
        };
        let (level, equations) = (&self.levels[s + k], &self.chains[s][k]);
        if below.is_empty() {
            self.solve_coarsest(s, here);
            return Ok(());
        }
        for _ in 0..SWEEPS {
            check(progress)?;
            sweep(level, equations, &here.b, &mut here.x);
        }
        defect(level, equations, &here.b, &here.x, &mut here.defect);
        restrict_defect(level, equations, reading, &here.defect, &mut below[0].b);
        below[0].x.fill([0.0; WIDTH]);
        self.descend(s, k + 1, reading, below, progress)?;
        add_correction_from(level, equations, reading, &below[0].x, &here.defect, &mut here.x);
        for _ in 0..SWEEPS {
            check(progress)?;
            sweep(level, equations, &here.b, &mut here.x);
        }
        Ok(())
    }

    /// The coarsest equations of chain `s`, solved exactly.
    pub(super) fn solve_coarsest(&self, s: usize, vectors: &mut PaperVectors) {
        let inverse = &self.inverses[s];
        for (i, x) in vectors.x.iter_mut().enumerate() {
            *x = inverse.row_times(i, &vectors.b);
        }
    }
}
