//! Threads that each run one piece of work alone.
//!
//! A solve on the threads of a pool synchronises after every colour and every pass. That makes one solve faster and
//! many slower: when every slot is taken, the threads only steal pieces of each other's solves, and pay for each with a
//! synchronisation and cold caches. Results are bit-identical for any number of threads.

use crate::pool::{Pool, PoolError};
use std::sync::{Arc, Mutex, PoisonError};

/// Pools of one thread, and which of them are free.
#[derive(Debug, Clone, Default)]
pub(super) struct LoneThreads {
    free: Arc<Mutex<Vec<Pool>>>,
}

/// A thread that is lent to one piece of work. Free again when dropped.
#[derive(Debug)]
pub(super) struct LoneThread {
    pool: Pool,
    home: LoneThreads,
}

impl LoneThreads {
    /// Starts so many; `begin` is run on each.
    ///
    /// # Errors
    /// [`PoolError`] when the system gives no more threads.
    pub fn start(threads: usize, begin: fn()) -> Result<Self, PoolError> {
        let started: Result<Vec<Pool>, PoolError> = (0..threads)
            .map(|_| Pool::started_with(1, "compute-alone", begin))
            .collect();
        Ok(Self {
            free: Arc::new(Mutex::new(started?)),
        })
    }

    /// A free one, if there is any. The one that was free last comes first: its stack is still in a cache.
    pub fn take(&self) -> Option<LoneThread> {
        let pool = self.free.lock().unwrap_or_else(PoisonError::into_inner).pop()?;
        Some(LoneThread {
            pool,
            home: self.clone(),
        })
    }
}

impl LoneThread {
    /// The thread.
    pub fn pool(&self) -> &Pool {
        &self.pool
    }
}

impl Drop for LoneThread {
    fn drop(&mut self) {
        let mut free = self.home.free.lock().unwrap_or_else(PoisonError::into_inner);
        free.push(self.pool.clone());
    }
}
