//! What was prepared for an animation.

use crate::engine::{Animation, Shader};
use std::collections::BTreeMap;
use std::sync::Arc;

/// An animation that is ready to be solved. What becomes of the session's deformer does not affect it.
pub(in crate::session) struct PreparedAnimation {
    pub animation: Animation,
    /// What makes normals and tangents, when they are wanted.
    pub shader: Option<Arc<Shader>>,
    /// The session's revision when it was prepared.
    pub revision: u64,
    /// Milliseconds by stage.
    pub build_ms: BTreeMap<String, f64>,
}

impl PreparedAnimation {
    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.animation.byte_size() + self.shader.as_ref().map_or(0, |s| s.byte_size())
    }
}

impl std::fmt::Debug for PreparedAnimation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PreparedAnimation(frames {:?})", self.animation.range())
    }
}
