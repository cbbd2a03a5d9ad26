//! How the nodes and weights of a graph were made, as far as an edit of the mesh needs to know.

use crate::graph::weights::CotangentScale;
use glam::DVec3;

/// What [`super::resample`] needs beside nodes and edges.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GraphRecipe {
    /// How cotangents of mesh edges are weighed; `None` with uniform weights.
    pub(super) cotangents: Option<CotangentScale>,
    /// How interior nodes of the paper's kind were placed; `None` where there are none.
    pub(super) inside: Option<InteriorRecipe>,
}

/// How interior nodes were placed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct InteriorRecipe {
    /// Place of grid A's node (0, 0, 0).
    pub(super) origin: DVec3,
    /// Side of a lattice cell.
    pub(super) interval: f64,
    /// Neighbours of a lattice node, 14 or 8.
    pub(super) valence: u32,
    /// Lattice nodes lie deeper than this.
    pub(super) depth: f64,
    /// Whether the inside of some part is known by the winding number of all its faces only.
    pub(super) soups: bool,
    /// For each solver vertex how far its copy is moved inwards where there is room, negative where the part is wound
    /// inside out; 0 on parts without interior nodes, which count as sheets.
    pub(super) reach: Vec<f32>,
    /// The passages along edges that parts with interior nodes lack to be closed, sorted.
    pub(super) open: Vec<[u32; 2]>,
}

impl GraphRecipe {
    /// Bytes held on the heap.
    pub(super) fn byte_size(&self) -> usize {
        self.inside.as_ref().map_or(0, |inside| {
            inside.reach.capacity() * size_of::<f32>() + inside.open.capacity() * size_of::<[u32; 2]>()
        })
    }
}
