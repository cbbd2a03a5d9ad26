//! A store that fails, or holds calls, when a test says so.

use futures::future::BoxFuture;
use pliant::session::store::{StoreError, StoreFaults};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::SeqCst};
use tokio::sync::watch;

/// What is to become of a store's calls.
#[derive(Debug, Default)]
pub struct Faults {
    /// Calls so far, sweeps not among them.
    pub calls: AtomicU64,
    /// The call that fails; 0: none.
    pub fails_at: AtomicU64,
    /// Whether every call fails.
    pub is_away: AtomicBool,
    /// Whether calls wait.
    pub held: watch::Sender<bool>,
}

impl StoreFaults for Faults {
    fn pass(&self) -> BoxFuture<'_, Result<(), StoreError>> {
        let call = self.calls.fetch_add(1, SeqCst) + 1;
        let fails = self.is_away.load(SeqCst) || call == self.fails_at.load(SeqCst);
        Box::pin(async move {
            let _ = self.held.subscribe().wait_for(|held| !held).await;
            match fails {
                true => Err(StoreError::Unavailable(format!("call {call} was made to fail"))),
                false => Ok(()),
            }
        })
    }
}
