//! How a server stops: reject new work, notify open streams, wait, then end.

use crate::session::calls::manager::Manager;
use crate::session::error::Error;
use crate::session::keeping::heartbeat::beat;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;

/// Between two checks whether all sessions are released.
const BETWEEN_LOOKS: Duration = Duration::from_millis(10);

/// The notice to streams when the server stops.
const GOING_AWAY: &str = "the server is shutting down; commits are still stored. Close this stream and open it again, with the resume token as \
                          the session's id: a server with the same sessions continues there";

impl Manager {
    /// Whether new sessions are accepted: not draining, memory below the high-water mark.
    pub fn admits(&self) -> bool {
        let ledger = &self.shared.ledger;
        let mark = ledger.total() as f64 * self.shared.config.high_water;
        !self.shared.draining.load(SeqCst) && ledger.used() as f64 <= mark
    }

    /// Whether changes can be stored: false from a failed write to the store until one works again.
    pub fn takes_writes(&self) -> bool {
        self.shared.store.as_ref().is_none_or(|store| store.takes_writes())
    }

    /// Rejects new sessions and streams from now on, notifies the open streams, and stores what they committed.
    pub fn start_drain(&self) {
        if self.shared.draining.swap(true, SeqCst) {
            return;
        }
        for session in self.shared.registry.all() {
            for mailbox in session.streams.all() {
                mailbox.leave(GOING_AWAY);
            }
            // Where other nodes wait for it, it goes as soon as nobody uses it.
            session.wake.notify_one();
        }
        let shared = Arc::clone(&self.shared);
        tokio::spawn(async move { beat(&shared).await });
    }

    /// Waits until no call and no stream is under way.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn drained(&self) {
        self.shared.gate.empty().await;
        let store = self.shared.store.as_ref();
        if store.is_some_and(|store| store.ownership().is_some()) {
            // Sessions that are given back with their newest shape come back sooner at another node.
            while !self.shared.registry.all().is_empty() {
                tokio::time::sleep(BETWEEN_LOOKS).await;
            }
        }
    }

    /// Stops everything at once: work, calls and streams end with `UNAVAILABLE`, sessions are gone.
    pub fn abort(&self) {
        self.shared.draining.store(true, SeqCst);
        self.shared.aborted.cancel();
        self.shared.abort_flag.cancel();
        for session in self.shared.registry.all() {
            session.close(Error::draining());
        }
    }
}
