//! Other methods than the paper's, to compare with. The solve on the graph knows none of them.

mod rotations;
mod spatial_rbf;

pub(super) use rotations::{diffuse, linear_frames};
pub use spatial_rbf::SpatialRbf;
