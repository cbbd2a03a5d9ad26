//! The outer iteration: flexible conjugate gradients on all columns of a group, preconditioned by one multigrid cycle.
//!
//! It goes in *stretches*. A stretch begins with the residual in double precision and iterates a correction in single
//! precision. Once rounding shows in the residual, the correction is added to the solution and the next stretch
//! begins from the true residual, in the same search direction: single precision never limits the result.

use crate::build::hierarchy::power_of_two_below;
use crate::error::Error;
use crate::lanes::{Lanes, WIDTH, WideLanes, per_lane, ratio};
use crate::options::SolveMethod;
use crate::progress::Cancelled;
use crate::solve::advance::{
    StepNorms, add_correction, advance, first_residual, fold, longest_step, reference, residual, resume,
};
use crate::solve::criteria::GroupOutcome;
use crate::solve::cycle::{clear_inactive, prepare};
use crate::solve::group::GroupSolve;
use crate::solve::iteration::{IterationReport, IterationWatcher, SolutionSnapshot, SolveControl};
use crate::solve::problem::ColumnGroup;
use crate::solve::workspace::Workspace;

/// A stretch ends once the residual fell by this factor: single precision has few digits left.
const STRETCH: f64 = 1e-5;
/// Rounding of one step, relative to the largest diagonal times the norm of the correction.
const ROUNDING: f64 = 2e-7;
/// The same after an exact first step.
const ROUNDING_DEEP: f64 = 6e-8;
/// A stretch ends once rounding is this part of the residual. Rounding is smooth as much as rough, while the residual
/// of a good iterate has lost its smooth part: rounding spoils the solution long before it shows in norms.
const SPOILT: f64 = 0.03;
/// Tolerances below this one are worth an exact first step.
const DEEP: f64 = 1e-4;
/// An estimate that rounding may have spoilt is believed if it is this many times below what is asked for.
const AMPLE: f64 = 4.0;
/// The same where only the residual matters.
const LOST: f64 = 0.3;
/// A recurred residual is taken for the true one while rounding stays below this part of the tolerance.
const TRUSTED: f64 = 0.1;
/// After more steps than this a recurred residual is not trusted, whatever rounding should have done to it.
const LONG: f64 = 12.0;
/// Below this relative residual nothing can be gained in double precision.
const FLOOR: f64 = 1e-14;
/// Iterations that must at least halve the residual.
const PATIENCE: usize = 12;
/// Iterations that solves stay below unless something is wrong: their history has room from the first solve on.
const USUAL: usize = 64;
/// Stretches in a row that may fail to halve the true residual.
const POOR_STRETCHES: usize = 2;

/// What is carried from iteration to iteration.
struct OuterState {
    outcome: GroupOutcome,
    /// Norms of b, which residuals are relative to.
    reference: WideLanes,
    /// Power of two by which the vectors of a stretch are multiplied.
    scale: WideLanes,
    /// (p, A p) of the last direction.
    direction: Option<WideLanes>,
    /// Largest row of the last step.
    last_step: Option<f64>,
    /// 1 for columns that have stopped.
    resting: WideLanes,
    /// Error estimate of those.
    resting_error: f64,
    /// False if rounding may have spoilt the last error estimate.
    sound: bool,
}

/// How a stretch ended.
enum InnerEnd {
    /// The caller can have x as it is.
    Accepted,
    /// Look at the true residual and go on.
    Ended,
    /// Little or no progress.
    Troubled,
    /// Numbers that are not finite; the correction of this stretch was thrown away.
    Ruined,
}

impl GroupSolve<'_, '_> {
    /// Iterates on `workspace.x` from the values it holds.
    pub(crate) fn solve(&mut self, watch: &mut IterationWatcher<'_>) -> Result<GroupOutcome, Error> {
        let (problem, threads, pool) = (self.problem, self.problem.threads, self.pool);
        let n = problem.hierarchy.levels[0].rows();
        let width = problem.width();
        let grid = self.cycle.grid(0);
        let Workspace {
            x,
            fine,
            coarse,
            history,
            ..
        } = &mut *self.workspace;
        history.clear();
        history.reserve(USUAL);
        fine.resize(n);
        // A solve that was cancelled or ruined has left a correction behind.
        fine.e.fill(Lanes::ZERO);
        clear_inactive(&grid, &mut fine.z);
        clear_inactive(&grid, &mut fine.t);
        clear_inactive(&grid, &mut fine.last_e);
        prepare(&self.cycle, coarse);

        let mut state = OuterState {
            outcome: GroupOutcome::new(SolveMethod::Multigrid),
            reference: [0.0; WIDTH],
            scale: [1.0; WIDTH],
            direction: None,
            last_step: None,
            resting: [0.0; WIDTH],
            resting_error: 0.0,
            sound: true,
        };
        let mut first = Some(threads.enter(pool, || {
            if self.from_zero {
                let norms = first_residual(&problem, x, fine);
                state.reference = norms.map(f64::sqrt);
                norms
            } else {
                state.reference = reference(&problem, x);
                residual(&problem, x, fine, state.scale)
            }
        }));
        let mut beginning: Option<WideLanes> = None;
        let mut last: Option<WideLanes> = None;
        let mut rescaled: Option<WideLanes> = None;
        let mut poor = 0;
        loop {
            let Workspace { x, fine, .. } = &mut *self.workspace;
            let mut norms = match first.take() {
                Some(norms) => norms,
                None => threads.enter(pool, || {
                    let norms = residual(&problem, x, fine, state.scale);
                    if let Some(factor) = rescaled.take() {
                        resume(&grid, fine, factor, &mut state.direction);
                    }
                    norms
                }),
            };
            if norms.iter().any(|r| !r.is_finite()) && state.outcome.iterations == 0 {
                // Frames of absurd size can overflow the full-multigrid start.
                problem.load(self.caller, false, x);
                norms = threads.enter(pool, || residual(&problem, x, fine, state.scale));
            }
            if norms.iter().any(|r| !r.is_finite()) {
                let iterations = state.outcome.iterations;
                return Err(Error::Diverged {
                    iterations,
                    residual: f64::INFINITY,
                });
            }
            let relative = relative_norms(norms, &mut state.reference);
            let beginning = *beginning.get_or_insert(relative);
            let outcome = &mut state.outcome;
            outcome.relative = relative;
            outcome.factor = mean_factor(beginning, relative, outcome.iterations);
            let exact = relative.iter().all(|r| *r <= FLOOR);
            if exact && outcome.iterations == 0 {
                outcome.max_error = 0.0;
            }
            let sound = state.sound || self.criteria.max_error.is_none();
            let holds = sound && self.criteria.hold(&relative[..width], outcome.max_error);
            outcome.converged = exact || (holds && outcome.iterations > 0);
            if outcome.converged || outcome.iterations >= self.criteria.max_iterations {
                return Ok(*outcome);
            }
            if let Some(last) = last.replace(relative) {
                let idle = (0..WIDTH).all(|c| relative[c] > 0.5 * last[c] || relative[c] <= FLOOR);
                poor = if idle { poor + 1 } else { 0 };
            }
            if poor >= POOR_STRETCHES {
                if at_rounding(&problem, x, relative, state.reference) {
                    return Ok(*outcome);
                }
                return crate::solve::fallback::conjugate_gradients(self, state.reference, state.outcome, watch);
            }

            match self.stretch(&mut state, watch)? {
                InnerEnd::Accepted => {
                    let outcome = &mut state.outcome;
                    outcome.factor = mean_factor(beginning, outcome.relative, outcome.iterations);
                    return Ok(*outcome);
                }
                InnerEnd::Ended => {}
                InnerEnd::Troubled => {
                    poor += 1;
                    state.direction = None;
                }
                InnerEnd::Ruined => {
                    state.outcome.relative = relative;
                    return crate::solve::fallback::conjugate_gradients(self, state.reference, state.outcome, watch);
                }
            }
            // The next residual is about this large; bring its entries near 1 for single precision.
            let before = state.scale;
            for c in 0..WIDTH {
                let rms = state.outcome.relative[c] * state.reference[c] / (n as f64).sqrt();
                state.scale[c] = if rms > 1e-200 {
                    1.0 / power_of_two_below(rms)
                } else {
                    1.0
                };
            }
            rescaled = Some(per_lane(|c| state.scale[c] / before[c]));
        }
    }

    /// One stretch from the residual in `fine.r`; adds its correction to x.
    fn stretch(&mut self, state: &mut OuterState, watch: &mut IterationWatcher<'_>) -> Result<InnerEnd, Error> {
        let (problem, threads, pool, criteria) = (self.problem, self.problem.threads, self.pool, self.criteria);
        let width = problem.width();
        let grid = self.cycle.grid(0);
        let start = state.outcome.relative;
        let scale = state.scale;
        // Of the vectors' norms in units of the relative residual, and of their entries in the caller's.
        let norm_unit = per_lane(|c| scale[c] * state.reference[c]);
        let unit = per_lane(|c| problem.unit[c] / scale[c]);
        let largest_unit = unit[..width].iter().fold(0.0f64, |a, &b| a.max(b));
        let left = |c: usize| c < width && start[c] > FLOOR;
        // Columns stay at rest unless the true residual says otherwise.
        state.resting = per_lane(|c| {
            if criteria.rests(start[c]) {
                state.resting[c]
            } else {
                0.0
            }
        });
        let mut open = per_lane(|c| if left(c) { 1.0 - state.resting[c] } else { 0.0 });
        if open == [0.0; WIDTH] {
            (state.resting, state.resting_error) = (open, 0.0);
            open = per_lane(|c| f64::from(u8::from(left(c))));
        }
        let (mut fresh, mut steps) = (true, 0.0);
        // Small residuals are reached sooner if the first step leaves no rounding behind.
        let deep = problem.system.floating.is_empty() && criteria.tolerance.is_some_and(|t| t < DEEP);
        let verdict = loop {
            let weights = per_lane(|c| if open[c] > 0.0 { unit[c] / largest_unit } else { 0.0 });
            let Workspace { fine, coarse, .. } = &mut *self.workspace;
            let StepNorms {
                rr,
                ee,
                longest,
                broken,
            } = threads
                .enter(pool, || {
                    advance(
                        &self.cycle,
                        &grid,
                        fine,
                        coarse,
                        &mut state.direction,
                        (fresh, deep),
                        open,
                        weights,
                    )
                })
                .map_err(|Cancelled| Error::Cancelled)?;
            state.outcome.iterations += 1;
            if rr.iter().any(|v| !v.is_finite()) || !longest.is_finite() {
                return Ok(InnerEnd::Ruined);
            }
            let before = state.outcome.relative;
            let now = per_lane(|c| {
                if open[c] > 0.0 {
                    ratio(rr[c].sqrt(), norm_unit[c])
                } else {
                    before[c]
                }
            });
            let lanes = || (0..width).filter(|&c| open[c] > 0.0);
            let history = &mut self.workspace.history;
            history.push(lanes().map(|c| now[c] / before[c]).fold(0.0, f64::max));
            // What rounding may have added to the true residual without the recurrence noticing.
            steps += 1.0;
            let rounding = if deep { ROUNDING_DEEP } else { ROUNDING };
            let rounding = rounding * f64::sqrt(steps) * problem.hierarchy.largest_diagonal;
            let noise = per_lane(|c| ratio(rounding * ee[c].sqrt(), norm_unit[c]));
            let share = lanes().map(|c| ratio(noise[c], now[c])).fold(0.0, f64::max);
            state.sound = share <= SPOILT;
            let step = longest * largest_unit;
            let shrinkage = state.last_step.replace(step).map(|last| ratio(step, last));
            let moving = estimate(history, step, shrinkage, share);
            state.outcome.relative = now;
            state.outcome.max_error = libm::hypot(state.resting_error, moving);

            let claimed = per_lane(|c| now[c] + 2.0 * noise[c]);
            let holds = criteria.hold(&claimed[..width], state.outcome.max_error);
            let iteration = IterationReport {
                index: state.outcome.iterations,
                columns: problem.columns(),
                residual: now[..width].iter().fold(0.0, |a, &b| a.max(b)),
                max_error: state.outcome.max_error,
                snapshot: SolutionSnapshot {
                    problem,
                    x: &self.workspace.x,
                    e: Some((&self.workspace.fine.e, per_lane(|c| 1.0 / scale[c]))),
                    caller: self.caller,
                },
            };
            if watch(&iteration) == SolveControl::Stop {
                state.outcome.stopped = true;
                state.outcome.converged = holds;
                break InnerEnd::Accepted;
            }
            if holds {
                let quiet = |c: usize| criteria.tolerance.is_none_or(|t| noise[c] <= TRUSTED * t);
                let trusted = steps <= LONG && (0..width).all(quiet);
                let error = state.outcome.max_error;
                let ample = |m: f64| share <= LOST && AMPLE * error <= m;
                let sound = state.sound || criteria.max_error.is_none_or(ample);
                state.outcome.converged = trusted && sound;
                break if state.outcome.converged {
                    InnerEnd::Accepted
                } else {
                    InnerEnd::Ended
                };
            }
            // Before the second iteration nothing is known about the error of what would rest.
            let rests = |c: usize| state.outcome.iterations > 1 && open[c] > 0.0 && criteria.rests(claimed[c]);
            if (0..width).any(rests) {
                let weights = per_lane(|c| if rests(c) { weights[c] } else { 0.0 });
                let Workspace { fine, history, .. } = &mut *self.workspace;
                let longest = threads.enter(pool, || longest_step(&grid, fine, weights));
                let left = estimate(history, longest * largest_unit, shrinkage, share);
                state.resting_error = libm::hypot(state.resting_error, left);
                let still = per_lane(|c| if rests(c) { 0.0 } else { open[c] });
                state.resting = per_lane(|c| if rests(c) { 1.0 } else { state.resting[c] });
                open = still;
            }
            if deep && fresh {
                let Workspace { x, fine, .. } = &mut *self.workspace;
                threads.enter(pool, || fold(&grid, fine, scale, x));
            }
            fresh = false;
            let spent = (0..width).any(|c| open[c] > 0.0 && now[c] <= (STRETCH * start[c]).max(FLOOR));
            let spoilt = share
                > if deep && criteria.max_error.is_none() {
                    LOST
                } else {
                    SPOILT
                };
            if spoilt || spent || open == [0.0; WIDTH] || state.outcome.iterations >= criteria.max_iterations {
                break InnerEnd::Ended;
            }
            let history = &self.workspace.history;
            let recent = history.len().saturating_sub(PATIENCE);
            let slow = recent > 0 && history[recent..].iter().product::<f64>() > 0.5;
            if broken || slow {
                break InnerEnd::Troubled;
            }
        };
        let Workspace { x, fine, .. } = &mut *self.workspace;
        threads.enter(pool, || add_correction(&problem, &grid, fine, scale, x));
        Ok(verdict)
    }
}

/// Residual norms relative to those of b. A column without right-hand side is measured against its first residual.
fn relative_norms(squares: WideLanes, reference: &mut WideLanes) -> WideLanes {
    per_lane(|c| {
        let norm = squares[c].sqrt();
        if reference[c] == 0.0 {
            reference[c] = norm;
        }
        if norm > 0.0 { norm / reference[c] } else { 0.0 }
    })
}

/// True if the residual is about what computing it in double precision leaves, so that no method can go on.
fn at_rounding(problem: &ColumnGroup<'_>, x: &[WideLanes], relative: WideLanes, reference: WideLanes) -> bool {
    const PRODUCT: f64 = 100.0 * f64::EPSILON;
    let mut squares = [0.0; WIDTH];
    for x in x {
        for c in 0..WIDTH {
            squares[c] += x[c] * x[c];
        }
    }
    let limit = PRODUCT * problem.hierarchy.largest_diagonal;
    (0..WIDTH).all(|c| relative[c] * reference[c] <= limit * squares[c].sqrt())
}

/// Geometric mean of the reduction per iteration, slowest column.
fn mean_factor(from: WideLanes, to: WideLanes, iterations: usize) -> f64 {
    let worst = (0..WIDTH)
        .filter(|&c| from[c] > 0.0)
        .map(|c| to[c] / from[c])
        .fold(0.0, f64::max);
    if iterations == 0 {
        0.0
    } else {
        libm::pow(worst, 1.0 / iterations as f64)
    }
}

/// Distance to the solution after a step, from the largest row of the step.
///
/// Summing what later steps will move, each ρ times the one before, gives step · ρ / (1 − ρ). ρ is the mean reduction
/// of the residual, or the last one if that was slower, without the first one, which removes what is rough and tells
/// nothing about the smooth error that is left. Steps see that error better but fall less evenly, so where their last
/// `shrinkage` says that it fell faster, it has a part in ρ only. The error falls unevenly too, hence a floor: on volume graphs, a step is followed
/// by 0.1 to 0.5 times its length. Where rounding makes up a large `share` of the residual, its smooth part keeps the
/// error from falling with it.
fn estimate(history: &[f64], step: f64, shrinkage: Option<f64>, share: f64) -> f64 {
    const LEAST: f64 = 0.22;
    const MOST: f64 = 0.95;
    const BY_STEPS: f64 = 0.3;
    const HARMLESS: f64 = 0.2;
    let later = if history.len() > 1 { &history[1..] } else { history };
    let mean = libm::pow(later.iter().product::<f64>(), 1.0 / later.len().max(1) as f64);
    let by_residual = mean.max(history.last().copied().unwrap_or(0.0)).min(MOST);
    let by_steps = shrinkage.map_or(by_residual, |s| s.clamp(1e-3, MOST));
    let mixed = libm::pow(by_residual, 1.0 - BY_STEPS) * libm::pow(by_steps, BY_STEPS);
    let rho = mixed.min(by_residual).max(LEAST);
    step * rho / (1.0 - rho) * (1.0 + 1.5 * (share - HARMLESS).max(0.0))
}
