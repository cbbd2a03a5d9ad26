//! Which node takes what nobody has yet: new sessions go where there is room, and who comes to a node that is about to stop is sent to
//! another one.

use crate::session::calls::manager::Manager;
use crate::session::error::Error;
use crate::session::keeping::heartbeat::load_of;
use crate::session::owner_address::OwnerAddress;
use crate::session::store::NodeLoad;
use std::sync::atomic::Ordering::SeqCst;

/// A new session goes elsewhere where so much more is free there, as a share of what may be held.
const WORTH_THE_WAY: f64 = 0.2;

impl NodeLoad {
    /// How much of what it may hold a node holds: memory or sessions, whichever is more.
    fn share(&self) -> f64 {
        let share = |used: u64, most: u64| used as f64 / most.max(1) as f64;
        share(self.memory_used, self.memory_total).max(share(self.sessions, self.most_sessions))
    }
}

impl Manager {
    /// Why a call is refused while this server is about to stop: with another node, where there is one.
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

    /// Sends a new session to another node where that has clearly more room: the better one of this node and another, chosen by chance. Whom
    /// a node has sent already stays.
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

    /// Another node that takes sessions, chosen by chance; `None` where there is none, or the store does not say.
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
