//! What a deformer may hold.

use crate::asset;
use crate::progress::Progress;

/// What is too large where a deformer would hold more bytes than it may.
pub const ESTIMATED_MEMORY: &str = "the estimated memory of the session in bytes";

/// What a deformer may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeformerLimits {
    /// Sizes of the model.
    pub model: asset::Limits,
    /// Bytes that the deformer may hold; checked by estimate before anything large is allocated.
    pub memory_bytes: u64,
    /// Bytes for volume graphs: a graph that needs more gets a wider lattice, or none. `None`: `memory_bytes`. Shapes
    /// depend on it; they do not depend on `memory_bytes`, which may be the free memory of the moment. To get the same
    /// bits again, open a model with the same number.
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

impl DeformerLimits {
    /// The limits of a model that is read: what reading it takes is of the same memory.
    pub(super) fn of_reading(&self) -> asset::Limits {
        asset::Limits {
            decoded_bytes: self.model.decoded_bytes.min(self.memory_bytes),
            document_bytes: self.model.document_bytes.min(self.memory_bytes),
            ..self.model
        }
    }
}

/// Watches work beside which a deformer holds bytes already.
pub(super) struct HeldBeside<'a> {
    /// The bytes that it holds.
    pub held: u64,
    /// Who watches the deformer.
    pub watcher: &'a dyn Progress,
}

impl Progress for HeldBeside<'_> {
    fn cancelled(&self) -> bool {
        self.watcher.cancelled()
    }

    fn may_hold(&self, bytes: u64) -> bool {
        self.watcher.may_hold(self.held.saturating_add(bytes))
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        self.watcher.report(stage, fraction);
    }

    fn begin_pass(&self, pass: &'static str) {
        self.watcher.begin_pass(pass);
    }
}
