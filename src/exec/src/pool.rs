//! The thread budget that every computing function takes.
//!
//! The crates below pliant-wire never use rayon's global pool: they are given a [`Pool`] and run inside it, so that a caller
//! decides how many cores a piece of work may use. Results never depend on the number of threads.

use rayon::prelude::*;
use std::sync::Arc;

/// A bounded set of threads on which parallel work runs. Cloning shares the threads.
///
/// ```
/// use pliant_exec::pool::Pool;
///
/// let pool = Pool::new(2)?;
/// assert_eq!(pool.threads(), 2);
/// assert_eq!(pool.install(|| (1..=100).sum::<i32>()), 5050);
/// # Ok::<(), pliant_exec::pool::PoolError>(())
/// ```
#[derive(Clone)]
pub struct Pool {
    threads: Arc<rayon::ThreadPool>,
    /// Whether who queues work waits until it is done.
    is_inline: bool,
}

/// The threads of a pool could not be started.
#[derive(Debug, thiserror::Error)]
#[error("cannot start {threads} compute threads: {reason}")]
pub struct PoolError {
    /// How many were asked for.
    pub threads: usize,
    /// What the operating system said.
    pub reason: String,
}

impl Pool {
    /// Starts `threads` threads; 0 means one for each core that this process may use.
    pub fn new(threads: usize) -> Result<Self, PoolError> {
        Self::started_with(threads, "compute", || {})
    }

    /// As [`Pool::new`]; threads are called `pliant-ROLE-N`, and each begins with `on_start`.
    ///
    /// # Errors
    /// [`PoolError`].
    pub fn started_with(
        threads: usize,
        role: &'static str,
        on_start: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, PoolError> {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(move |i| format!("pliant-{role}-{i}"))
            .start_handler(move |_| on_start())
            .build()
            .map(|pool| Self {
                threads: Arc::new(pool),
                is_inline: false,
            })
            .map_err(|e| PoolError {
                threads,
                reason: e.to_string(),
            })
    }

    /// Number of threads, at least 1.
    pub fn threads(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Runs `work` on this pool, blocking the caller until it is done; rayon calls inside `work` stay on this pool.
    pub fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        self.threads.install(work)
    }

    /// What `value` returns for each number below `count`, computed on this pool; a thread takes at least `fewest` of them at a time.
    ///
    /// ```
    /// use pliant_exec::pool::Pool;
    /// assert_eq!(Pool::new(1)?.map(3, 1024, |i| i * i), [0, 1, 4]);
    /// # Ok::<(), pliant_exec::pool::PoolError>(())
    /// ```
    pub fn map<T: Send>(&self, count: usize, fewest: usize, value: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        self.install(|| (0..count).into_par_iter().with_min_len(fewest).map(value).collect())
    }

    /// Runs `work` on this pool while the calling thread, which is not one of the pool's, runs `here`; returns what that returns once
    /// both have ended.
    ///
    /// ```
    /// use pliant_exec::pool::Pool;
    ///
    /// let pool = Pool::new(1)?;
    /// let (send, squares) = std::sync::mpsc::channel();
    /// let work = move || (1..=3).for_each(|n| send.send(n * n).expect("it is read"));
    /// assert_eq!(pool.run_beside(work, || squares.iter().sum::<i32>()), 14);
    /// # Ok::<(), pliant_exec::pool::PoolError>(())
    /// ```
    pub fn run_beside<R>(&self, work: impl FnOnce() + Send, here: impl FnOnce() -> R) -> R {
        self.threads.in_place_scope(|scope| {
            scope.spawn(|_| work());
            here()
        })
    }

    /// Queues `work` without waiting for it, unless the pool is [inline](Pool::inline).
    pub fn spawn(&self, work: impl FnOnce() + Send + 'static) {
        match self.is_inline {
            true => self.threads.install(work),
            false => self.threads.spawn(work),
        }
    }

    /// The same threads; who queues work waits until it is done, so that what happens meanwhile is the same each time.
    ///
    /// ```
    /// use pliant_exec::pool::Pool;
    /// use std::sync::{Arc, atomic::{AtomicBool, Ordering::SeqCst}};
    ///
    /// let (pool, done) = (Pool::new(1)?.inline(), Arc::new(AtomicBool::new(false)));
    /// let inside = Arc::clone(&done);
    /// pool.spawn(move || inside.store(true, SeqCst));
    /// assert!(done.load(SeqCst));
    /// # Ok::<(), pliant_exec::pool::PoolError>(())
    /// ```
    #[must_use]
    pub fn inline(self) -> Self {
        Self {
            is_inline: true,
            ..self
        }
    }
}

impl std::fmt::Debug for Pool {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Pool({})", self.threads())
    }
}
