//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005).
//!
//! `build` runs the stages in order: `solid` finds which parts enclose space, `caps` closes their holes, `shell` moves
//! copies of vertices inwards, `lattice` (by `scan` or as an octree) fills the inside with nodes of the `lattice_grid`
//! and joins them, and `placing` gives each of them its vertex. `placing` makes the paper's graph, `shape` the one that
//! follows the shape: `principal_axes` gives the axes of its lattice, and `spread` ties the surface to it and joins what
//! is too thin for it.

pub(in crate::graph) mod build;
pub(super) mod caps;
mod lattice;
pub(super) mod lattice_grid;
mod options;
mod placing;
mod principal_axes;
mod scan;
mod shape;
pub(super) mod shell;
pub(super) mod solid;
pub(super) mod spread;

pub use build::{estimate_nodes, volume, volume_apart};
pub use options::{InteriorKind, VolumeOptions};
