//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005).
//!
//! `build` runs the stages in order: `solid` finds which parts enclose space, `caps` closes their holes, `shell` moves
//! copies of vertices inwards, `lattice` (by `scan` or `octree`) fills the inside with nodes of the `lattice_grid` and
//! joins them, and `placing` gives each of them its vertex. They query the surface by `near_surface`, and by `columns`
//! what is inside. `placing` makes the paper's graph, `shape` the one that follows the shape: `principal_axes` gives the
//! axes of its lattice, `thickness` its width, and `spread` ties the surface to it and joins what is too thin for it.

pub(in crate::graph) mod build;
pub(super) mod caps;
pub(super) mod columns;
mod lattice;
pub(super) mod lattice_grid;
mod near_surface;
pub(super) mod neighbours;
mod octree;
mod options;
mod placing;
mod principal_axes;
mod scan;
mod shape;
pub(super) mod shell;
pub(super) mod solid;
pub(super) mod spread;
mod thickness;

pub use build::{estimate_nodes, volume, volume_apart};
pub use options::{InteriorKind, VolumeOptions};
