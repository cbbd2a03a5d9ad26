//! Cycles until the criteria hold, and what happens when they never would.

use crate::error::Error;
use crate::lanes::{WIDTH, WideLanes, per_lane, ratio};
use crate::options::{InitialGuess, SolveMethod};
use crate::paper::cycle::vectors;
use crate::paper::hierarchy::PaperHierarchy;
use crate::paper::kept::UncutGraph;
use crate::paper::smooth::ConjugateSteps;
use crate::paper::start::{FrameOffsets, ZeroOffsets};
use crate::solve::advance::reference;
use crate::solve::criteria::GroupOutcome;
use crate::solve::fallback::conjugate_gradients;
use crate::solve::group::GroupSolve;
use crate::solve::iteration::{IterationReport, IterationWatcher, SolutionSnapshot, SolveControl};

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
/// Unlike the rest of the solver it allocates its vectors anew.
pub(crate) fn solve(
    outer: &mut GroupSolve<'_, '_>,
    paper: &PaperHierarchy,
    kept: &UncutGraph,
    start: InitialGuess<'_>,
    watch: &mut IterationWatcher<'_>,
) -> Result<GroupOutcome, Error> {
    let (problem, pool, criteria) = (outer.problem, outer.pool, outer.criteria);
    let (threads, progress, width) = (problem.threads, outer.cycle.progress, problem.width());
    let floating = &problem.system.floating;
    let mut reference = threads.enter(pool, || reference(&problem, &outer.workspace.x));
    let mut outcome = GroupOutcome::new(SolveMethod::PaperCycles);
    let (mut levels, mut conjugate) = (vectors(paper), ConjugateSteps::default());
    if let (InitialGuess::FullMultigrid { frames, rest }, true) = (start, paper.usable) {
        let [r, ..] = &mut outer.workspace.wide;
        let x = &mut outer.workspace.x;
        r.resize(x.len(), [0.0; WIDTH]);
        // x is 0 on free rows, so that this is b.
        threads.enter(pool, || problem.wide_residual(x, r));
        gather(paper, r, &mut levels[0].b);
        match frames {
            Some(frames) => {
                let framed = FrameOffsets {
                    vertices: &paper.vertices,
                    frames,
                    rest: rest.unwrap_or(&kept.positions),
                    unit: problem.unit,
                };
                paper.full_multigrid(&framed, &mut levels, progress)?;
            }
            None => paper.full_multigrid(&ZeroOffsets, &mut levels, progress)?,
        }
        // Frames of absurd size can overflow; then 0 is the better start.
        if finite(&levels[0].x) {
            scatter(paper, &levels[0].x, x);
            floating.remove_wide_means(x);
        }
    }
    let steps = paper.steps.unwrap_or(match criteria.tolerance {
        Some(t) if t <= STEPS.1 => STEPS.0,
        _ => 0,
    });
    let mut history = CycleHistory::default();
    let mut beginning = None;
    loop {
        let x = &mut outer.workspace.x;
        let [r, ..] = &mut outer.workspace.wide;
        r.resize(x.len(), [0.0; WIDTH]);
        let norms = threads.enter(pool, || problem.wide_residual(x, r));
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
        let worst = outcome.relative.iter().fold(0.0f64, |a, &b| a.max(b));
        let from = *beginning.get_or_insert(worst);
        history.residuals.push(worst);
        let exact = worst <= FLOOR;
        if outcome.iterations == 0 {
            outcome.max_error = if exact { 0.0 } else { f64::INFINITY };
        } else {
            outcome.max_error = history.estimate();
            outcome.factor = libm::pow(ratio(worst, from), 1.0 / outcome.iterations as f64);
            let iteration = IterationReport {
                index: outcome.iterations,
                columns: problem.columns(),
                residual: worst,
                max_error: outcome.max_error,
                snapshot: SolutionSnapshot {
                    problem,
                    x,
                    e: None,
                    caller: outer.caller,
                },
            };
            outcome.stopped = watch(&iteration) == SolveControl::Stop;
        }
        let holds = outcome.iterations > 0 && criteria.hold(&outcome.relative[..width], outcome.max_error);
        outcome.converged = exact || holds;
        if outcome.converged || outcome.stopped || outcome.iterations >= criteria.max_iterations {
            return Ok(outcome);
        }
        let left = criteria.max_iterations - outcome.iterations;
        if !paper.usable || history.fails() || history.is_late(criteria.tolerance, left) {
            return conjugate_gradients(outer, reference, outcome, watch);
        }

        // The cycle is linear, so that improving x for b is improving 0 for the defect.
        let finest = &mut levels[0];
        gather(paper, r, &mut finest.b);
        finest.x.fill([0.0; WIDTH]);
        paper.cycle(0, &mut levels, progress)?;
        let finest = &mut levels[0];
        let (level, equations) = (&paper.levels[0], &paper.chains[0][0]);
        conjugate.run((level, equations), &finest.b, &mut finest.x, steps, progress)?;
        if !finite(&finest.x) {
            return conjugate_gradients(outer, reference, outcome, watch);
        }
        history.steps.push(longest(&finest.x, problem.unit));
        for (&row, e) in paper.rows.iter().zip(&finest.x) {
            for c in 0..WIDTH {
                x[row as usize][c] += e[c];
            }
        }
        floating.remove_wide_means(x);
        outcome.iterations += 1;
    }
}

/// Values of the finest level's vertices from those in row order.
fn gather(paper: &PaperHierarchy, rows: &[WideLanes], out: &mut [WideLanes]) {
    for (&row, out) in paper.rows.iter().zip(out) {
        *out = rows[row as usize];
    }
}

fn scatter(paper: &PaperHierarchy, values: &[WideLanes], rows: &mut [WideLanes]) {
    for (&row, v) in paper.rows.iter().zip(values) {
        rows[row as usize] = *v;
    }
}

fn finite(x: &[WideLanes]) -> bool {
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
