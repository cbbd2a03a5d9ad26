//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005).
//!
//! `build` goes through the stages in order: `solid` tells which parts enclose space, `caps` closes their holes, `inward`
//! and `shell` move a copy of each vertex inwards, `lattice` (by `scan` or `octree`) fills the inside with nodes and joins them,
//! `nearest` gives each of them its vertex, and `placed` puts it all together. They ask the surface by `near_surface`.
//! `apart` builds one graph for each part.

mod angle;
mod apart;
pub(in crate::graph) mod build;
pub(super) mod caps;
pub(super) mod columns;
mod inward;
mod lattice;
pub(super) mod lattice_grid;
mod near_surface;
mod nearest;
pub(super) mod neighbours;
mod octree;
mod placed;
mod scan;
pub(super) mod shell;
pub(super) mod solid;

pub use apart::volume_apart;
pub use build::{VolumeOptions, estimate_nodes, volume};
