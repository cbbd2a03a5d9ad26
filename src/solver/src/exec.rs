//! Where a piece of work runs and who watches it, handed down as one argument.

use crate::pool::Pool;
use crate::progress::{Cancelled, Progress, check};

/// The threads that a piece of work may use, and the watcher that can cancel it. Every function that computes for longer than
/// a moment takes one, so that no engine reaches for global threads or runs on after nobody wants its result.
///
/// ```
/// use pliant_solver::{exec::Exec, pool::Pool, progress::Silent};
///
/// let pool = Pool::new(1)?;
/// let exec = Exec::new(&pool, &Silent);
/// assert!(exec.check().is_ok());
/// # Ok::<(), pliant_solver::pool::PoolError>(())
/// ```
#[derive(Clone, Copy)]
pub struct Exec<'a> {
    /// Threads that parallel parts run on.
    pub pool: &'a Pool,
    /// Told how far the work is, and asked whether it is still wanted.
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
