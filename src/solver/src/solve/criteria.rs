//! When a solve stops, and what became of a group of columns.

use crate::lanes::{WIDTH, WideLanes};
use crate::options::SolveMethod;

/// When to stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StoppingCriteria {
    pub(crate) tolerance: Option<f64>,
    pub(crate) max_error: Option<f64>,
    pub(crate) max_iterations: usize,
}

impl StoppingCriteria {
    /// True if all criteria that were given hold, and at least one was.
    pub(crate) fn hold(&self, relative: &[f64], max_error: f64) -> bool {
        let residual = relative.iter().all(|r| self.tolerance.is_none_or(|t| *r <= t));
        let error = self.max_error.is_none_or(|m| max_error <= m);
        residual && error && (self.tolerance.is_some() || self.max_error.is_some())
    }

    /// The largest part that residual and error are of what is allowed.
    pub(crate) fn nearness(&self, relative: &[f64], max_error: f64) -> f64 {
        let worst = relative.iter().fold(0.0f64, |a, &b| a.max(b));
        let residual = self.tolerance.map_or(0.0, |t| worst / t);
        self.max_error.map_or(residual, |m| residual.max(max_error / m))
    }

    /// True if a column at this relative residual needs no more iterations, whatever the others need.
    pub(crate) fn rests(&self, relative: f64) -> bool {
        self.max_error.is_none() && self.tolerance.is_some_and(|t| relative <= t)
    }
}

/// What became of a group of columns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GroupOutcome {
    pub(crate) iterations: usize,
    pub(crate) relative: WideLanes,
    pub(crate) max_error: f64,
    pub(crate) factor: f64,
    pub(crate) method: SolveMethod,
    pub(crate) stopped: bool,
    pub(crate) converged: bool,
}

impl GroupOutcome {
    pub(crate) fn new(method: SolveMethod) -> Self {
        Self {
            iterations: 0,
            relative: [0.0; WIDTH],
            max_error: f64::INFINITY,
            factor: 0.0,
            method,
            stopped: false,
            converged: false,
        }
    }
}
