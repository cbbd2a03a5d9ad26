//! Rigs of upright figures: where the joints of a body lie in a mesh, and which joints of a clip turn its bones.
//!
//! A body has the joints of [`BODY_JOINTS`] and the bones of [`BODY_BONES`]. [`bones_of_names`] finds which joints of a
//! clip turn which bone by their names, [`bones_of_shape`] by how the skeleton branches. [`find_body`] finds the joints
//! in a mesh that stands upright and faces along z, in a lattice of the cells that it occupies: hands are the ends
//! farthest along it, arms are between them and the trunk, a gap separates the legs. [`rig_of_body`] combines both: it
//! moves joints of limbs to the middle of what is around them, and makes bones as thick as that is.

mod clip_bones;
mod found_body;
mod rig_of_body;

pub use clip_bones::bones_of_shape;
pub use clip_bones::{BODY_BONES, BODY_JOINTS, BodyBone};
pub use clip_bones::{ClipBones, bones_of_names, preset_skeleton};
pub use found_body::{FoundBody, find_body};
pub use rig_of_body::PlacedJoint;
pub use rig_of_body::{BodyRig, rig_of_body};
