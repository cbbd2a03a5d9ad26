//! Progress reports and cancellation of long work.

use std::sync::atomic::{AtomicBool, Ordering};

/// Watches one piece of work. Implementations must be cheap: kernels call `cancelled` between sweeps.
pub trait Progress: Sync {
    /// True to cancel the work, which then stops at its next check and returns `Cancelled`.
    fn cancelled(&self) -> bool {
        false
    }

    /// Whether the work may hold `bytes` in all, its input included; called before large allocations. If false, the
    /// work ends with an error that contains the size.
    fn may_hold(&self, bytes: u64) -> bool {
        let _ = bytes;
        true
    }

    /// Reports that `fraction` (0 to 1) of `stage` is done. Called rarely, from the thread that started the work.
    fn report(&self, stage: &'static str, fraction: f32) {
        let _ = (stage, fraction);
    }

    /// Reports the name of a pass over the rows of one frame that begins, for measurements. Called some ten times a
    /// frame, from one thread at a time.
    fn begin_pass(&self, pass: &'static str) {
        let _ = pass;
    }
}

/// Work without reports or cancellation.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {}

/// Its [`Progress`] cancelled the work.
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
/// use pliant_exec::progress::{CancelFlag, Cancelled, check};
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
