//! Other methods than the paper's, to compare with. The solve on the graph knows none of them.

mod linear_frames;
mod orientation_diffusion;
mod spatial_rbf;
mod spatial_rbf_solve;

pub(super) use linear_frames::linear_frames;
pub(super) use orientation_diffusion::diffuse;
pub use spatial_rbf_solve::SpatialRbf;
