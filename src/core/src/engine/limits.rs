//! What a deformer may hold.

use crate::asset;

/// What a deformer may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeformerLimits {
    /// Sizes of the model.
    pub model: asset::Limits,
    /// Bytes that the deformer may hold; checked by estimate before anything large is allocated.
    pub memory_bytes: u64,
    /// Bytes that volume graphs are fitted into: what would hold more gets a wider lattice, or none. `None`: `memory_bytes`.
    /// Shapes depend on it, unlike on `memory_bytes`, which may be what happens to be free: whoever opens a model again for
    /// the same bits names what it was fitted into before.
    pub graph_bytes: Option<u64>,
    /// Handles of one request.
    pub handles: usize,
}

impl Default for DeformerLimits {
    fn default() -> Self {
        Self {
            model: asset::Limits::default(),
            memory_bytes: 16 << 30,
            graph_bytes: None,
            handles: 1024,
        }
    }
}
