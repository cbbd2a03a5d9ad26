//! Animations: a clip drives the bones of a rig, and every frame is solved as a pose of handles that the rig makes (paper,
//! section 7).
//!
//! [`Animation::prepare`] makes one of a [`ClipRequest`]: it finds the clip and its rig, and which frames are wanted; frames
//! that are kept become a model that plays them by [`Animation::write_clip`].
//!
//! An [`Animation`] has handles of its own and leaves the deformer's alone. Frames are solved in blocks of [`BLOCK_FRAMES`] at
//! absolute indices: each block is begun afresh, and within it every frame goes on from the one before. So blocks can be
//! solved at the same time, a range can be taken out or resumed, and the bits stay the same.

mod bound_model;
mod clip_request;
mod frames;
mod held_nodes;
mod key_frames;
mod left_out;
mod made_rig;
mod moving_clip;
mod played;
mod prepare;
mod sums;

pub use bound_model::{BoundModel, bind_model, carrying_joints, influences_of_skin};
pub use clip_request::{
    AnimationLimits, AnimationRefinement, AnimationSettings, BLOCK_FRAMES, ClipRequest, ClipSource, FrameChoice,
    FrameTimes,
};
pub use frames::{AnimatedFrame, FrameCursor, FrameSource};
pub use held_nodes::RigHandleFacts;
pub use left_out::{left_out_passengers, left_out_primitives};
pub use made_rig::{MadeRig, RigOrder, left_out_of_rig, make_rig};
pub use played::{PlayedClipFile, PlayedForm, WrittenError, node_place};
pub use prepare::{Animation, RigNodes};
pub use sums::FrameSums;
