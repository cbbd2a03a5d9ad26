//! What the outer iteration carries from step to step and from stretch to stretch.

use crate::build::hierarchy::power_of_two_below;
use crate::lanes::{WIDTH, WideLanes, per_lane};
use crate::options::SolveMethod;
use crate::solve::criteria::{GroupOutcome, StoppingCriteria};
use crate::solve::group::ReachedByCycles;
use crate::solve::recalled::RecalledSteps;

/// Below this relative residual nothing can be gained in double precision.
pub(super) const FLOOR: f64 = 1e-14;

/// The state of an outer iteration.
pub(super) struct OuterState {
    pub(super) outcome: GroupOutcome,
    /// Norms of b, which residuals are relative to.
    pub(super) reference: WideLanes,
    /// Power of two by which the vectors of a stretch are multiplied.
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
    /// Stretches in a row that failed to halve the true residual.
    pub(super) poor: usize,
    /// True relative residual when the first stretch began.
    beginning: Option<WideLanes>,
    /// The same when the present stretch began.
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
    pub(super) fn judge_recalled(&mut self, recalled: &RecalledSteps, criteria: &StoppingCriteria, width: usize) {
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

    /// Counts the stretches in a row that brought little; called with the true residual known.
    pub(super) fn count_poor_stretch(&mut self) {
        let relative = self.outcome.relative;
        if let Some(last) = self.last.replace(relative) {
            let idle = (0..WIDTH).all(|c| relative[c] > 0.5 * last[c] || relative[c] <= FLOOR);
            self.poor = if idle { self.poor + 1 } else { 0 };
        }
    }

    /// The outcome where the last stretch has reached what is asked for.
    pub(super) fn accepted(&self) -> GroupOutcome {
        let mut outcome = self.outcome;
        if let Some(beginning) = self.beginning {
            outcome.factor = mean_factor(beginning, outcome.relative, outcome.iterations);
        }
        outcome
    }

    /// Brings the entries of the next residual, which is about as large as the last one of the stretch, near 1 for single
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
