//! The weighted graph that deformation is solved on (paper section 2): the mesh's own edges, and inside closed parts a
//! volume graph after Zhou et al. 2005, which keeps them from collapsing.
//!
//! Owns nodes, edges, weights, components, and the winding number that building them needs. Handles, constraints and
//! solving are elsewhere.
//!
//! A volume graph has three kinds of nodes, in this order: the solver vertices of the mesh; the *shell*, a copy of each
//! vertex moved inwards; and the *lattice*, a body-centred cubic grid further inside. Module `volume` builds it,
//! `resample` follows an edit of the mesh, and `winding` finds what lies inside. `ties` joins parts of the mesh that
//! touch.

mod assemble;
mod mesh_graph;
pub mod parallel;
mod resample;
mod ties;
mod volume;
mod winding;

pub use assemble::surface;
pub use mesh_graph::{EdgeWeights, GraphRecipe, GraphStats, MeshGraph};
pub use resample::{MeshChange, ResampledGraph, resample};
pub use ties::{LOOSE, PartTies, TieAnchor, TieFamilies, TieOptions, resample_tied, tie_parts};
pub use volume::{InteriorKind, VolumeOptions, estimate_nodes, principal_axes, volume, volume_apart};
pub use winding::WindingTree;
