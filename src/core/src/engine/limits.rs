//! What a deformer may hold.

use crate::asset;

/// What a deformer may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeformerLimits {
    /// Sizes of the model.
    pub model: asset::Limits,
    /// Bytes that the deformer may hold; checked by estimate before anything large is allocated.
    pub memory_bytes: u64,
    /// Handles of one request.
    pub handles: usize,
}

impl Default for DeformerLimits {
    fn default() -> Self {
        Self {
            model: asset::Limits::default(),
            memory_bytes: 16 << 30,
            handles: 1024,
        }
    }
}
