//! How many connections each peer has open.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Connections by address. Cloning shares the count.
#[derive(Clone, Default)]
pub(super) struct Peers(Arc<Mutex<HashMap<IpAddr, u32>>>);

impl Peers {
    /// Counts one more connection of a peer; `None` where it has as many as are allowed.
    pub fn admit(&self, peer: IpAddr, most: u32) -> Option<PeerSlot> {
        let peer = peer.to_canonical();
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = open.entry(peer).or_insert(0);
        if *count >= most {
            return None;
        }
        *count += 1;
        Some(PeerSlot {
            peers: self.clone(),
            peer,
        })
    }
}

/// A connection of a peer; dropping it counts it out.
pub(super) struct PeerSlot {
    peers: Peers,
    peer: IpAddr,
}

impl Drop for PeerSlot {
    fn drop(&mut self) {
        let mut open = self.peers.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = open.get_mut(&self.peer) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.peer);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_that_leaves_makes_room_and_is_forgotten() {
        let peers = Peers::default();
        let [here, mapped, other]: [IpAddr; 3] = ["127.0.0.1", "::ffff:127.0.0.1", "::1"].map(|a| a.parse().unwrap());
        let first = peers.admit(here, 2);
        let second = peers.admit(mapped, 2);
        assert!(first.is_some() && second.is_some() && peers.admit(here, 2).is_none());
        assert!(peers.admit(other, 2).is_some());
        drop(first);
        assert!(peers.admit(here, 2).is_some());
        drop(second);
        assert!(peers.0.lock().unwrap().is_empty());
    }
}
