//! What can go wrong in the solver.

use pliant_exec::progress::Cancelled;

/// Why a hierarchy was not built or a system not solved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The caller's [`Progress`](pliant_exec::progress::Progress) asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// An argument breaks a rule; the text says which, the value seen and what is allowed.
    #[error("{0}")]
    Invalid(String),
    /// Neither multigrid nor the fallbacks produced finite numbers.
    #[error(
        "the solver diverged after {iterations} iterations at relative residual {residual:e}; \
         weights or values span too many orders of magnitude"
    )]
    Diverged {
        /// Iterations done before giving up.
        iterations: usize,
        /// Last finite relative residual.
        residual: f64,
    },
    /// A feature that this build of the solver does not have.
    #[error("unsupported: {0}")]
    Unsupported(&'static str),
}

impl From<Cancelled> for Error {
    fn from(_: Cancelled) -> Self {
        Error::Cancelled
    }
}
