//! Which node takes a new session: it goes where there is room, and a node that is about to stop sends clients to
//! another one.

use crate::session::calls::manager::Manager;
use crate::session::error::Error;
use crate::session::keeping::heartbeat::load_of;
use crate::session::owner_address::OwnerAddress;
use crate::session::store::NodeLoad;
use std::sync::atomic::Ordering::SeqCst;

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
        let mut random = [0u8; 8];
        getrandom::fill(&mut random).ok()?;
        let chosen = usize::try_from(u64::from_le_bytes(random) % others.len().max(1) as u64).ok()?;
        (chosen < others.len()).then(|| others.swap_remove(chosen))
    }
}
