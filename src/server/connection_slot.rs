//! One of the connections that may be open at a time.

use super::peers::PeerSlot;
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

/// A connection's place among those that may be open, in all and of its peer; held by the connection and by the WebSocket it becomes.
#[derive(Clone)]
pub(super) struct ConnectionSlot {
    _held: Arc<(OwnedSemaphorePermit, PeerSlot)>,
}

impl ConnectionSlot {
    /// Holds a place until the last clone is dropped.
    pub fn new(permit: OwnedSemaphorePermit, peer: PeerSlot) -> Self {
        Self {
            _held: Arc::new((permit, peer)),
        }
    }
}
