//! The first pass: every node's rotation and scale, blended from the handles' by their fields (paper section 2.1).

pub(super) mod blend;
pub(super) mod quick_frames;
pub(super) mod spread;

pub use blend::{LocalFrame, LocalRotation, PoseBlend, pack_rotation};
pub use spread::frames;
