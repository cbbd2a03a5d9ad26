//! Animations: a clip drives the bones of a rig, and every frame is solved as a pose of handles that the rig makes (paper,
//! section 7).
//!
//! [`Animation::prepare`] makes one of a [`ClipRequest`]: it finds the clip and its rig, and which frames are wanted; frames
//! that are kept become a model that plays them by [`Animation::write_clip`].
//!
//! An [`Animation`] has handles of its own and leaves the deformer's alone. Frames are solved in blocks of [`BLOCK_FRAMES`] at
//! absolute indices: each block is begun afresh, and within it every frame goes on from the one before. So blocks can be
//! solved at the same time, a range can be taken out or resumed, and the bits stay the same.

mod frames;
mod held_nodes;
mod key_frames;
mod made_rig;
mod moving_clip;
mod parted_frames;
mod played;
mod prepare;

pub use frames::{AnimatedFrame, FrameCursor, FrameSource, FrameSums};
pub use held_nodes::RigHandleFacts;
pub use made_rig::{
    BoundModel, MadeRig, RigOrder, bind_model, carrying_joints, influences_of_skin, left_out_of_rig,
    left_out_passengers, left_out_primitives, make_rig,
};
pub use played::{PlayedClipFile, PlayedForm, WrittenError, node_place};
pub use prepare::{
    ANIMATION_QUALITY, Animation, AnimationLimits, BLOCK_FRAMES, ClipRequest, ClipSource, FootFacts, FrameChoice,
    FrameTimes, RigNodes,
};
