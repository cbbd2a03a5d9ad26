//! Other methods than the paper's, to compare with.

pub(super) mod linear_frames;
pub(super) mod orientation_diffusion;
pub(super) mod spatial_rbf;
mod spatial_rbf_solve;
