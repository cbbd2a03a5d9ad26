//! How long work reports where it is, and how it learns that nobody wants it any more.

use std::sync::atomic::{AtomicBool, Ordering};

/// Watches one piece of work. Implementations must be cheap: kernels ask `cancelled` between sweeps.
pub trait Progress: Sync {
    /// True once the result is no longer wanted; the work then stops at its next check and returns `Cancelled`.
    fn cancelled(&self) -> bool {
        false
    }

    /// Asked before something large is allocated: whether the work may hold `bytes` in all, what it was given included.
    /// Where the answer is no, the work ends with an error that names the size.
    fn may_hold(&self, bytes: u64) -> bool {
        let _ = bytes;
        true
    }

    /// Tells that `fraction` (0 to 1) of `stage` is done. Called rarely, from the thread that started the work.
    fn report(&self, stage: &'static str, fraction: f32) {
        let _ = (stage, fraction);
    }

    /// Tells that a pass over the rows of one frame begins, by its name. For those who measure frames; called some ten times a
    /// frame, from one thread at a time.
    fn begin_pass(&self, pass: &'static str) {
        let _ = pass;
    }
}

/// Work that nobody watches or cancels.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {}

/// The work was given up because its [`Progress`] said so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// Returns `Err(Cancelled)` when the work is no longer wanted.
pub fn check(progress: &dyn Progress) -> Result<(), Cancelled> {
    if progress.cancelled() { Err(Cancelled) } else { Ok(()) }
}

/// A flag that any thread can raise.
///
/// ```
/// use pliant_solver::progress::{CancelFlag, Cancelled, check};
///
/// let flag = CancelFlag::default();
/// assert_eq!(check(&flag), Ok(()));
/// flag.cancel();
/// assert_eq!(check(&flag), Err(Cancelled));
/// ```
#[derive(Debug, Default)]
pub struct CancelFlag(AtomicBool);

impl CancelFlag {
    /// Asks the work to stop at its next check.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Progress for CancelFlag {
    fn cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
