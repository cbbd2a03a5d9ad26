//! Rotations: as vectors with any number of turns, fitted to points, and blended with weights.

pub(super) mod blending;
pub(super) mod fit;
pub(super) mod vector;

pub use blending::blend_rotations;
pub use fit::fit_rigid_motion;
pub use vector::{exp_rotation, log_rotation};
