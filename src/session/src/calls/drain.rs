//! How a server stops: reject new work, notify open streams, wait, then end. A new session goes to a node where there is room, and a
//! node that is about to stop sends clients to another one.

use crate::calls::manager::Manager;
use crate::error::Error;
use crate::error::OwnerAddress;
use crate::keeping::heartbeat::{beat, load_of};
use crate::store::NodeLoad;
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
            // Where other nodes wait for it, it goes as soon as it is unused.
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

/// A new session goes to a node whose share in use is lower by this much.
const WORTH_THE_WAY: f64 = 0.2;

impl NodeLoad {
    /// The share of a node's limit in use: of memory or sessions, whichever is more.
    fn share(&self) -> f64 {
        let share = |used: u64, most: u64| used as f64 / most.max(1) as f64;
        share(self.memory_used, self.memory_total).max(share(self.sessions, self.most_sessions))
    }
}

impl Manager {
    /// The error of a call while this server is about to stop; names another node, where there is one.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn leaving(&self) -> Error {
        let owner = self.other_node().await.map(|(owner, _)| Box::new(owner));
        Error {
            owner,
            ..Error::draining()
        }
    }

    /// Sends a new session to another node, chosen at random, if that has clearly more room. A session that a node has
    /// sent stays.
    ///
    /// # Errors
    /// `UNAVAILABLE` with that node.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn place_new(&self, was_sent: bool) -> Result<(), Error> {
        if was_sent || self.shared.draining.load(SeqCst) {
            return Ok(());
        }
        match self.other_node().await {
            Some((owner, load)) if load.share() + WORTH_THE_WAY < load_of(&self.shared).share() => {
                self.shared.metrics.sent_elsewhere.inc();
                Err(Error::placed(owner))
            }
            _ => Ok(()),
        }
    }

    /// Another node that takes sessions, chosen at random; `None` without one, or when the store fails.
    async fn other_node(&self) -> Option<(OwnerAddress, NodeLoad)> {
        let ownership = self.shared.store.as_ref()?.ownership()?;
        let mut others = ownership.nodes().await.ok()?;
        others.retain(|(owner, _)| owner.node != ownership.node().name);
        let random = self.shared.surroundings.random().ok()?;
        let chosen = usize::try_from(random % others.len().max(1) as u128).ok()?;
        (chosen < others.len()).then(|| others.swap_remove(chosen))
    }
}
