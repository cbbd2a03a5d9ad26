//! Animations: a clip drives the bones of a rig, and every frame is solved as a pose of handles that the rig makes (paper,
//! section 7).
//!
//! An [`Animation`] has handles of its own and leaves the deformer's alone. Frames are solved in blocks of [`BLOCK_FRAMES`] at
//! absolute indices: each block is begun afresh, and within it every frame goes on from the one before. So blocks can be
//! solved at the same time, a range can be taken out or resumed, and the bits stay the same.

mod frames;
mod held_nodes;
mod prepare;
mod settings;
mod sums;

pub use frames::{AnimatedFrame, FrameCursor};
pub use held_nodes::RigHandleFacts;
pub use prepare::{Animation, RigNodes};
pub use settings::{AnimationRefinement, AnimationSettings, BLOCK_FRAMES, FrameChoice, FrameTimes};
pub use sums::FrameSums;
