//! One of the connections that may be open at a time.

use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

/// A connection's place among those that may be open; held by the connection and by the WebSocket it becomes.
#[derive(Clone)]
pub(super) struct ConnectionSlot {
    _permit: Arc<OwnedSemaphorePermit>,
}

impl ConnectionSlot {
    /// Holds a place until the last clone is dropped.
    pub fn new(permit: OwnedSemaphorePermit) -> Self {
        Self {
            _permit: Arc::new(permit),
        }
    }
}
