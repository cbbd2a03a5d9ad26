//! Rotations: blended with weights, and rigid motions fitted to points.

pub(super) mod blending;
pub(super) mod fit;

pub use crate::mesh::rotation::{exp_rotation, log_rotation};
pub use blending::blend_rotations;
pub use fit::fit_rigid_motion;
