//! The inner iterations, those of one run: a correction in single precision from one true residual. [`OuterState`] is
//! what passes from step to step and from run to run.

use crate::build::hierarchy::power_of_two_below;
use crate::error::Error;
use crate::lanes::{WIDTH, WideLanes, per_lane, ratio};
use crate::options::SolveMethod;
use crate::solve::advance::{StepNorms, StepTerms, add_correction, fold_correction, longest_step, step_conjugate};
use crate::solve::group::{
    GroupOutcome, GroupSolve, IterationReport, IterationWatcher, ReachedByCycles, SolutionSnapshot, SolveControl,
    StoppingCriteria, Workspace,
};
use crate::solve::solution_subspace::SolutionSubspace;
use pliant_exec::progress::Cancelled;

/// A run ends once the residual fell by this factor: single precision has few digits left.
const RESTART_REDUCTION: f64 = 1e-5;
/// Rounding of one step, relative to the largest diagonal times the norm of the correction.
const ROUNDING: f64 = 2e-7;
/// The same after an exact first step.
const ROUNDING_AFTER_EXACT_STEP: f64 = 6e-8;
/// A run ends once rounding is this part of the residual. Rounding is smooth as much as rough, while the residual
/// of a good iterate has lost its smooth part: rounding spoils the solution long before it shows in norms.
const MOST_ROUNDING: f64 = 0.03;
/// Tolerances below this one are worth an exact first step.
const EXACT_STEP_TOLERANCE: f64 = 1e-4;
/// An estimate that rounding may have falsified is accepted if it is this many times below the tolerance.
const ERROR_MARGIN: f64 = 4.0;
/// The same where only the residual matters.
const MOST_ROUNDING_OF_RESIDUAL: f64 = 0.3;
/// A recurred residual is taken for the true one while rounding stays below this part of the tolerance.
const RELIABLE_ROUNDING: f64 = 0.1;
/// After more steps than this a recurred residual is not trusted, whatever rounding should have done to it.
const MOST_RELIABLE_STEPS: f64 = 12.0;
/// Iterations that must at least halve the residual.
const PATIENCE: usize = 12;

/// How a run ended.
pub(super) enum InnerEnd {
    /// The caller can have x as it is.
    Accepted,
    /// Look at the true residual and go on.
    Ended,
    /// Little or no progress.
    Stagnated,
    /// Numbers that are not finite; the correction of this run was thrown away.
    NotFinite,
}

/// The state of one run.
struct InnerState {
    /// True relative residual that the run began with.
    start: WideLanes,
    /// The vectors' norms in units of the relative residual.
    norm_unit: WideLanes,
    /// The vectors' entries in the caller's units, and the largest of these units.
    unit: WideLanes,
    largest_unit: f64,
    /// 1 for columns that are iterated.
    open: WideLanes,
    /// True until the first step is done.
    fresh: bool,
    /// Steps done.
    steps: f64,
    /// True if the first step is exact: small residuals are reached sooner if it leaves no rounding behind.
    deep: bool,
}

/// What one step has brought.
struct StepProgress {
    /// Relative residual by recurrence.
    relative: WideLanes,
    /// What rounding may have added to the true residual without the recurrence noticing.
    noise: WideLanes,
    /// Relative residual that can be claimed, noise included.
    claimed: WideLanes,
    /// The largest part that noise has in a residual.
    share: f64,
    /// Length of the step over that of the one before.
    shrinkage: Option<f64>,
    /// True if the matrix or the preconditioner looked indefinite.
    broken: bool,
}

impl GroupSolve<'_, '_> {
    /// One run from the residual in `fine.r`; adds its correction to x.
    pub(super) fn inner_iterations(
        &mut self,
        state: &mut OuterState,
        watch: &mut IterationWatcher<'_>,
    ) -> Result<InnerEnd, Error> {
        let (problem, criteria) = (self.problem, self.criteria);
        let (threads, pool, grid) = (problem.threads, self.pool, self.cycle.grid(0));
        let scale = state.scale;
        let mut inner = self.begin_run(state);
        self.cycle.progress.begin_pass("cycles");
        let verdict = loop {
            let norms = self.advance(state, &inner)?;
            state.outcome.iterations += 1;
            if norms.rr.iter().any(|v| !v.is_finite()) || !norms.longest.is_finite() {
                return Ok(InnerEnd::NotFinite);
            }
            inner.steps += 1.0;
            let progress = self.judge_step(state, &inner, &norms);
            let holds = criteria.hold(&progress.claimed[..problem.width()], state.outcome.max_error);
            if self.show_iteration(state, watch) == SolveControl::Stop {
                state.outcome.stopped = true;
                state.outcome.converged = holds;
                break InnerEnd::Accepted;
            }
            if holds {
                state.outcome.converged = self.is_trusted(state, &inner, &progress);
                break if state.outcome.converged {
                    InnerEnd::Accepted
                } else {
                    InnerEnd::Ended
                };
            }
            self.rest_columns(state, &mut inner, &progress);
            if inner.deep && inner.fresh {
                let Workspace { x, fine, .. } = &mut *self.workspace;
                if let Some(recalled) = self.recalled.as_deref_mut() {
                    threads.run_on(pool, || recalled.add(&problem, &fine.e, scale));
                }
                threads.run_on(pool, || fold_correction(&grid, fine, scale, x));
            }
            inner.fresh = false;
            if let Some(end) = self.run_end(state, &inner, &progress) {
                break end;
            }
        };
        self.cycle.progress.begin_pass("correct");
        let Workspace { x, fine, .. } = &mut *self.workspace;
        if let Some(recalled) = self.recalled.as_deref_mut() {
            threads.run_on(pool, || recalled.add(&problem, &fine.e, scale));
        }
        threads.run_on(pool, || add_correction(&problem, &grid, fine, scale, x));
        Ok(verdict)
    }

    /// Chooses the columns of a run and the units of its vectors.
    fn begin_run(&self, state: &mut OuterState) -> InnerState {
        let (problem, criteria) = (self.problem, self.criteria);
        let width = problem.width();
        let start = state.outcome.relative;
        let unit = per_lane(|c| problem.unit[c] / state.scale[c]);
        let left = |c: usize| c < width && start[c] > FLOOR;
        // Columns stay unchanged unless the true residual says otherwise.
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
        InnerState {
            start,
            norm_unit: per_lane(|c| state.scale[c] * state.reference[c]),
            unit,
            largest_unit: unit[..width].iter().fold(0.0f64, |a, &b| a.max(b)),
            open,
            fresh: true,
            steps: 0.0,
            deep: problem.system.floating.is_empty() && criteria.tolerance.is_some_and(|t| t < EXACT_STEP_TOLERANCE),
        }
    }

    /// One step of conjugate gradients on the open columns.
    fn advance(&mut self, state: &mut OuterState, inner: &InnerState) -> Result<StepNorms, Error> {
        let grid = self.cycle.grid(0);
        let terms = StepTerms {
            fresh: inner.fresh,
            exact: inner.deep,
            open: inner.open,
            weights: inner.weights(),
        };
        let (cycle, Workspace { fine, coarse, .. }) = (&self.cycle, &mut *self.workspace);
        self.problem
            .threads
            .run_on(self.pool, || {
                step_conjugate(cycle, &grid, fine, coarse, &mut state.direction, &terms)
            })
            .map_err(|Cancelled| Error::Cancelled)
    }

    /// Reads residual and error of the last step off its norms.
    fn judge_step(&mut self, state: &mut OuterState, inner: &InnerState, norms: &StepNorms) -> StepProgress {
        let problem = self.problem;
        let before = state.outcome.relative;
        let now = per_lane(|c| {
            if inner.open[c] > 0.0 {
                ratio(norms.rr[c].sqrt(), inner.norm_unit[c])
            } else {
                before[c]
            }
        });
        let lanes = || (0..problem.width()).filter(|&c| inner.open[c] > 0.0);
        let history = &mut self.workspace.history;
        history.push(lanes().map(|c| now[c] / before[c]).fold(0.0, f64::max));
        let rounding = if inner.deep {
            ROUNDING_AFTER_EXACT_STEP
        } else {
            ROUNDING
        };
        let rounding = rounding * f64::sqrt(inner.steps) * problem.hierarchy.largest_diagonal;
        let noise = per_lane(|c| ratio(rounding * norms.ee[c].sqrt(), inner.norm_unit[c]));
        let share = lanes().map(|c| ratio(noise[c], now[c])).fold(0.0, f64::max);
        state.sound = share <= MOST_ROUNDING;
        let step = norms.longest * inner.largest_unit;
        state.moved += step;
        let shrinkage = state.last_step.replace(step).map(|last| ratio(step, last));
        let moving = estimate_error(history, step, shrinkage, share);
        state.outcome.relative = now;
        state.outcome.max_error = libm::hypot(state.resting_error, moving);
        StepProgress {
            relative: now,
            noise,
            claimed: per_lane(|c| now[c] + 2.0 * noise[c]),
            share,
            shrinkage,
            broken: norms.broken,
        }
    }

    /// Shows the caller where the solve stands.
    fn show_iteration(&self, state: &OuterState, watch: &mut IterationWatcher<'_>) -> SolveControl {
        let (problem, outcome) = (self.problem, &state.outcome);
        let Workspace { x, fine, .. } = &*self.workspace;
        watch(&IterationReport {
            index: outcome.iterations,
            columns: problem.columns(),
            residual: outcome.relative[..problem.width()].iter().fold(0.0, |a, &b| a.max(b)),
            max_error: outcome.max_error,
            snapshot: SolutionSnapshot {
                problem,
                x,
                e: Some((&fine.e, per_lane(|c| 1.0 / state.scale[c]))),
                caller: self.caller,
            },
        })
    }

    /// True if criteria that hold by recurrence hold for the true residual and error too.
    fn is_trusted(&self, state: &OuterState, inner: &InnerState, progress: &StepProgress) -> bool {
        let criteria = self.criteria;
        let quiet = |c: usize| {
            criteria
                .tolerance
                .is_none_or(|t| progress.noise[c] <= RELIABLE_ROUNDING * t)
        };
        let trusted = inner.steps <= MOST_RELIABLE_STEPS && (0..self.problem.width()).all(quiet);
        let error = state.outcome.max_error;
        let ample = |m: f64| progress.share <= MOST_ROUNDING_OF_RESIDUAL && ERROR_MARGIN * error <= m;
        trusted && (state.sound || criteria.max_error.is_none_or(ample))
    }

    /// Lets columns rest that are done, with an estimate of the error they keep.
    fn rest_columns(&mut self, state: &mut OuterState, inner: &mut InnerState, progress: &StepProgress) {
        let (criteria, threads) = (self.criteria, self.problem.threads);
        let (open, iterations) = (inner.open, state.outcome.iterations);
        // Before the second iteration nothing is known about the error of what would rest.
        let rests = |c: usize| iterations > 1 && open[c] > 0.0 && criteria.rests(progress.claimed[c]);
        if !(0..self.problem.width()).any(rests) {
            return;
        }
        let all = inner.weights();
        let weights = per_lane(|c| if rests(c) { all[c] } else { 0.0 });
        let grid = self.cycle.grid(0);
        let Workspace { fine, history, .. } = &mut *self.workspace;
        let longest = threads.run_on(self.pool, || longest_step(&grid, fine, weights));
        let left = estimate_error(
            history,
            longest * inner.largest_unit,
            progress.shrinkage,
            progress.share,
        );
        state.resting_error = libm::hypot(state.resting_error, left);
        inner.open = per_lane(|c| if rests(c) { 0.0 } else { open[c] });
        state.resting = per_lane(|c| if rests(c) { 1.0 } else { state.resting[c] });
    }

    /// Why the run ends here, if it does.
    fn run_end(&self, state: &OuterState, inner: &InnerState, progress: &StepProgress) -> Option<InnerEnd> {
        let (criteria, open) = (self.criteria, inner.open);
        let (now, start) = (progress.relative, inner.start);
        let spent = (0..WIDTH).any(|c| open[c] > 0.0 && now[c] <= (RESTART_REDUCTION * start[c]).max(FLOOR));
        let most = if inner.deep && criteria.max_error.is_none() {
            MOST_ROUNDING_OF_RESIDUAL
        } else {
            MOST_ROUNDING
        };
        let rounded = progress.share > most;
        if rounded || spent || open == [0.0; WIDTH] || state.outcome.iterations >= criteria.max_iterations {
            return Some(InnerEnd::Ended);
        }
        let history = &self.workspace.history;
        let recent = history.len().saturating_sub(PATIENCE);
        let slow = recent > 0 && history[recent..].iter().product::<f64>() > 0.5;
        (progress.broken || slow).then_some(InnerEnd::Stagnated)
    }
}

impl InnerState {
    /// Weights of the columns in the length of a step.
    fn weights(&self) -> WideLanes {
        per_lane(|c| {
            if self.open[c] > 0.0 {
                self.unit[c] / self.largest_unit
            } else {
                0.0
            }
        })
    }
}

/// Distance to the solution after a step, from the largest row of the step.
///
/// Summing what later steps will move, each ρ times the one before, gives step · ρ / (1 − ρ). ρ is the mean reduction
/// of the residual, or the last one if that was slower, without the first one, which removes rough error and does not
/// measure the smooth error that is left. Steps see that error better but fall less evenly, so a last `shrinkage` that
/// is faster only contributes to ρ. The error falls unevenly too, hence a floor: on volume graphs, a step is followed
/// by 0.1 to 0.5 times its length. Where rounding makes up a large `share` of the residual, its smooth part keeps the
/// error from falling with it.
fn estimate_error(history: &[f64], step: f64, shrinkage: Option<f64>, share: f64) -> f64 {
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

/// Below this relative residual nothing can be gained in double precision.
pub(super) const FLOOR: f64 = 1e-14;

/// The state of an outer iteration.
pub(super) struct OuterState {
    pub(super) outcome: GroupOutcome,
    /// Norms of b, which residuals are relative to.
    pub(super) reference: WideLanes,
    /// Power of two by which the vectors of a run are multiplied.
    pub(super) scale: WideLanes,
    /// (p, A p) of the last direction.
    pub(super) direction: Option<WideLanes>,
    /// Largest row of the last step.
    pub(super) last_step: Option<f64>,
    /// Sum of the steps' largest rows.
    pub(super) moved: f64,
    /// 1 for columns that have stopped.
    pub(super) resting: WideLanes,
    /// Error estimate of those.
    pub(super) resting_error: f64,
    /// False if rounding may have falsified the error estimate.
    pub(super) sound: bool,
    /// Runs in a row that failed to halve the true residual.
    pub(super) poor: usize,
    /// True relative residual when the first run began.
    beginning: Option<WideLanes>,
    /// The same when the present run began.
    last: Option<WideLanes>,
}

impl OuterState {
    pub(super) fn new() -> Self {
        Self {
            outcome: GroupOutcome::new(SolveMethod::Multigrid),
            reference: [0.0; WIDTH],
            scale: [1.0; WIDTH],
            direction: None,
            last_step: None,
            moved: 0.0,
            resting: [0.0; WIDTH],
            resting_error: 0.0,
            sound: true,
            poor: 0,
            beginning: None,
            last: None,
        }
    }

    /// Compares the true residual, of these squared norms, with what is asked for. A column without right-hand side is
    /// measured against its first residual.
    pub(super) fn judge_residual(&mut self, squares: WideLanes, criteria: &StoppingCriteria, width: usize) {
        let relative = relative_norms(squares, &mut self.reference);
        let beginning = *self.beginning.get_or_insert(relative);
        let outcome = &mut self.outcome;
        outcome.relative = relative;
        outcome.factor = mean_factor(beginning, relative, outcome.iterations);
        let exact = relative.iter().all(|r| *r <= FLOOR);
        if exact && outcome.iterations == 0 {
            outcome.max_error = 0.0;
        }
        let sound = self.sound || criteria.max_error.is_none();
        let holds = sound && criteria.hold(&relative[..width], outcome.max_error);
        outcome.converged = exact || (holds && outcome.iterations > 0);
    }

    /// Before the first iteration: whether none is needed, since earlier poses explain the residual, and their errors are known.
    pub(super) fn judge_recalled(&mut self, recalled: &SolutionSubspace, criteria: &StoppingCriteria, width: usize) {
        let outcome = &mut self.outcome;
        let worst = outcome.relative[..width].iter().fold(0.0f64, |a, &b| a.max(b));
        let expected = recalled
            .expected_error(worst)
            .filter(|_| outcome.iterations == 0 && !outcome.converged);
        if let Some(error) = expected.filter(|e| criteria.hold(&outcome.relative[..width], *e)) {
            outcome.max_error = error;
            outcome.converged = true;
        }
    }

    /// What cycles have come to so far, if there were any.
    pub(super) fn reached(&self) -> Option<ReachedByCycles> {
        let from = self.beginning.unwrap_or_default();
        (self.outcome.iterations > 0).then(|| ReachedByCycles {
            scale: self.scale,
            moved: self.moved,
            from_relative: from.iter().fold(0.0, |a, &b| a.max(b)),
        })
    }

    /// Counts the runs in a row that brought little; called with the true residual known.
    pub(super) fn count_poor_run(&mut self) {
        let relative = self.outcome.relative;
        if let Some(last) = self.last.replace(relative) {
            let idle = (0..WIDTH).all(|c| relative[c] > 0.5 * last[c] || relative[c] <= FLOOR);
            self.poor = if idle { self.poor + 1 } else { 0 };
        }
    }

    /// The outcome where the last run has reached what is asked for.
    pub(super) fn accepted(&self) -> GroupOutcome {
        let mut outcome = self.outcome;
        if let Some(beginning) = self.beginning {
            outcome.factor = mean_factor(beginning, outcome.relative, outcome.iterations);
        }
        outcome
    }

    /// Brings the entries of the next residual, which is about as large as the last one of the run, near 1 for single
    /// precision. Returns the factor on the scale; the residual has `rows` rows.
    pub(super) fn rescale(&mut self, rows: usize) -> WideLanes {
        let before = self.scale;
        for c in 0..WIDTH {
            let rms = self.outcome.relative[c] * self.reference[c] / (rows as f64).sqrt();
            self.scale[c] = if rms > 1e-200 {
                1.0 / power_of_two_below(rms)
            } else {
                1.0
            };
        }
        per_lane(|c| self.scale[c] / before[c])
    }
}

/// Residual norms relative to those of b, or to the first residual where b is 0.
fn relative_norms(squares: WideLanes, reference: &mut WideLanes) -> WideLanes {
    per_lane(|c| {
        let norm = squares[c].sqrt();
        if reference[c] == 0.0 {
            reference[c] = norm;
        }
        if norm > 0.0 { norm / reference[c] } else { 0.0 }
    })
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
