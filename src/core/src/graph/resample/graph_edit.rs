//! What an edit does to the nodes and rows of a graph.

use crate::graph::resample::change::{ChangedPoints, GraphBefore, MeshChange, NewEdge, NodeNumbers};
use glam::DVec3;
use std::ops::Range;

/// Nodes copied in one go.
pub(super) const BLOCK: usize = 1 << 15;

/// What changes, in numbers as in [`NodeNumbers`].
pub(super) struct GraphEdit<'a> {
    pub(super) old: &'a GraphBefore<'a>,
    pub(super) change: &'a MeshChange<'a>,
    pub(super) points: &'a ChangedPoints,
    pub(super) numbers: &'a NodeNumbers,
    /// Old nodes that are gone, rising.
    pub(super) gone: Vec<u32>,
    /// Old vertices and copies that lose all edges to others of them.
    pub(super) outer: Vec<u32>,
    /// Old lattice nodes that lose all edges to others.
    pub(super) lattice: Vec<u32>,
    /// Old lattice nodes that lose their ties.
    pub(super) untied: Vec<u32>,
    /// Edges that are added, or added back.
    pub(super) links: Vec<NewEdge>,
    /// Places of shell and lattice nodes that are new or moved.
    pub(super) placed: Vec<(u32, DVec3)>,
    /// The solver vertex, by new number, of shell and lattice nodes that are new or have another one.
    pub(super) nearest: Vec<(u32, u32)>,
}

/// Rows that are rewritten, by rising node.
pub(super) struct FreshRows {
    /// Nodes after the edit.
    pub(super) nodes: Vec<u32>,
    pub(super) offsets: Vec<u32>,
    pub(super) neighbours: Vec<u32>,
    pub(super) weights: Vec<f32>,
}

impl FreshRows {
    pub(super) fn range(&self, index: usize) -> Range<usize> {
        self.offsets[index] as usize..self.offsets[index + 1] as usize
    }

    pub(super) fn row(&self, index: usize) -> &[u32] {
        &self.neighbours[self.range(index)]
    }
}
