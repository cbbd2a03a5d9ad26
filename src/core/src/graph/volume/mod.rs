//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005).
//!
//! `build` runs the stages in order: `solid` finds which parts enclose space, `caps` closes their holes, `inward` and
//! `shell` move copies of vertices inwards, `lattice` (by `scan` or `octree`) fills the inside with nodes and joins
//! them, and `nearest` gives each of them its vertex. They query the surface by `near_surface`. `placed` makes the
//! paper's graph, `shape` the one that follows the shape: `principal_axes` gives the axes of its lattice, `thickness`
//! its width, `spread` ties the surface to it, and `struts` joins what is too thin for it. `apart` builds one graph for
//! each part.

pub(in crate::graph) mod build;
pub(super) mod lattice;
pub(super) mod neighbours;
mod octree;
mod options;
mod placing;
mod principal_axes;
pub(super) mod scan;
pub(super) mod shape;
pub(super) mod solid;
pub(super) mod spread;
pub(super) mod thickness;

pub use build::{estimate_nodes, volume};
pub use options::{InteriorKind, VolumeOptions};
pub use thickness::volume_apart;
