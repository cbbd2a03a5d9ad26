//! When a node of several last heard from the store that they share, and one lock for each session that is on its way into memory or
//! out of it.

use dashmap::DashMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::{Mutex as AsyncMutex, OwnedMutexGuard};
use tokio::time::Instant;

/// When this node had a word with the store.
#[derive(Debug, Default)]
pub(crate) struct LeaseWatch {
    times: Mutex<WordTimes>,
    /// Held by who speaks.
    pub speaking: tokio::sync::Mutex<()>,
}

/// When words were said.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct WordTimes {
    /// When the last one was begun that was answered.
    pub heard: Option<Instant>,
    /// When the last one was begun.
    pub tried: Option<Instant>,
}

impl LeaseWatch {
    /// When words were said.
    pub fn times(&self) -> WordTimes {
        *self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a word that was begun then.
    pub fn note(&self, begun: Instant, is_heard: bool) {
        let mut times = self.times.lock().unwrap_or_else(PoisonError::into_inner);
        times.tried = Some(begun);
        if is_heard {
            times.heard = Some(begun);
        }
    }
}

/// The locks, by the ids of sessions. One exists only while a task holds it or waits.
#[derive(Debug, Default)]
pub(crate) struct SessionLocks(Arc<DashMap<String, Arc<AsyncMutex<()>>>>);

/// The lock of a session, held.
#[derive(Debug)]
pub(crate) struct SessionLock {
    locks: Arc<DashMap<String, Arc<AsyncMutex<()>>>>,
    id: String,
    held: Option<OwnedMutexGuard<()>>,
}

impl SessionLocks {
    /// Waits for the lock of a session.
    pub async fn lock(&self, id: &str) -> SessionLock {
        let mutex = Arc::clone(self.0.entry(id.to_owned()).or_default().value());
        let mut lock = SessionLock {
            locks: Arc::clone(&self.0),
            id: id.to_owned(),
            held: None,
        };
        lock.held = Some(mutex.lock_owned().await);
        lock
    }
}

impl Drop for SessionLock {
    fn drop(&mut self) {
        self.held = None;
        // One count is the map's.
        self.locks.remove_if(&self.id, |_, mutex| Arc::strong_count(mutex) == 1);
    }
}

#[cfg(test)]
mod session_locks_tests {
    use super::*;

    #[tokio::test]
    async fn one_holds_a_lock_and_nothing_is_left_of_it() {
        let locks = SessionLocks::default();
        let first = locks.lock("a").await;
        let _other = locks.lock("b").await;
        let mut second = Box::pin(locks.lock("a"));
        assert!(futures::poll!(&mut second).is_pending());
        drop(first);
        drop(second.await);
        assert_eq!(locks.0.len(), 1, "that of b");
    }
}
