//! Rigs: which bones of a model a clip's joints drive, and how.
//!
//! A [`MotionRig`] says where joints lie in a model and which bones run between them. [`RigDriver`] brings it together with a
//! clip: bones get base poses that fit the clip's at a reference frame, the clip is turned to face as the model does, and each
//! bone's rigid motion follows for any time, relative to the root bone's. [`rig_handles`] makes handles of the bones by the
//! paper's recipe (section 7: rotations along bones, positions at joints), with slices along limbs so that a twist is spread
//! instead of wringing them.

mod bone_pairs;
mod bones;
mod contacts;
mod drive;
mod foot_attitudes;
mod half_turns;
mod handles;
mod joints;
mod leg_reach;
mod legs;
mod of_skin;
mod planted_feet;
mod rigid_motion;
mod soles;

pub(crate) use bones::listed_names;
pub use bones::{MotionRig, ReferencePose, RestAttitude, RigBone, RigError};
pub use drive::{DriveOptions, RigDriver, RigPose};
pub use half_turns::BoneTurns;
pub use handles::{RigHandle, RigHandleShape, rig_handles};
pub use joints::{RigSkeleton, moved_joints, rig_joints, skin_bones};
pub use legs::Leg;
pub use of_skin::rig_of_skin;
pub use planted_feet::{FootContacts, PlantedFeet};
pub use rigid_motion::RigidMotion;
