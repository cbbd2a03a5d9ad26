//! Threads and progress of a piece of work, passed as one argument.

use crate::pool::Pool;
use crate::progress::{Cancelled, Progress, check};

/// The threads that a piece of work may use, and the watcher that can cancel it. Every function that computes for longer than
/// a moment takes one, so that no engine uses global threads or runs on after a cancellation.
///
/// ```
/// use pliant_exec::{Exec, pool::Pool, progress::Silent};
///
/// let pool = Pool::new(1)?;
/// let exec = Exec::new(&pool, &Silent);
/// assert!(exec.check().is_ok());
/// # Ok::<(), pliant_exec::pool::PoolError>(())
/// ```
#[derive(Clone, Copy)]
pub struct Exec<'a> {
    /// Threads that parallel parts run on.
    pub pool: &'a Pool,
    /// Receives the progress of the work and can cancel it.
    pub progress: &'a dyn Progress,
}

impl<'a> Exec<'a> {
    /// Joins threads and watcher.
    pub fn new(pool: &'a Pool, progress: &'a dyn Progress) -> Self {
        Self { pool, progress }
    }

    /// Returns `Err(Cancelled)` when the work is no longer wanted.
    ///
    /// # Errors
    /// [`Cancelled`] once the watcher says so.
    pub fn check(&self) -> Result<(), Cancelled> {
        check(self.progress)
    }
}
