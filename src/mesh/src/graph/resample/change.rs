//! What an edit of a mesh changes, and how nodes and edges are numbered while it is followed.
//!
//! What an edit does to the nodes and rows of a graph.

use crate::NONE;
use crate::graph::mesh_graph::MeshGraph;
use glam::DVec3;
use std::ops::Range;

/// An edit of a mesh, from the solver vertices (points) and triangles before to those after.
///
/// Old points that are left keep their order and come first; new ones follow.
#[derive(Debug, Clone, Copy)]
pub struct MeshChange<'a> {
    /// All points after the edit.
    pub positions: &'a [DVec3],
    /// All triangles after the edit, over these points.
    pub triangles: &'a [[u32; 3]],
    /// For each point its number before the edit, rising; [`NONE`] from the first new one on.
    pub old_from_new: &'a [u32],
    /// Triangles that are gone, over the points before the edit.
    pub removed: &'a [[u32; 3]],
    /// Triangles that are new, by number, rising.
    pub added: &'a [u32],
    /// Old points with a new position, by new number, rising.
    pub moved: &'a [u32],
}

/// A graph after an edit, and which of its nodes are which.
#[derive(Debug, Clone, PartialEq)]
pub struct ResampledGraph {
    /// The graph of the mesh after the edit.
    pub graph: MeshGraph,
    /// For each old node its number now, or [`NONE`]. Of each kind (surface, shell, lattice) old nodes keep their order,
    /// and new ones follow them.
    pub new_from_old: Vec<u32>,
    /// For each node its number before, or [`NONE`].
    pub old_from_new: Vec<u32>,
    /// Nodes that are new, or whose position, neighbours or weights changed; rising.
    pub touched: Vec<u32>,
}

/// The graph before an edit, with its nodes where they are by now.
#[derive(Clone, Copy)]
pub(super) struct GraphBefore<'a> {
    pub(super) graph: &'a MeshGraph,
    /// Hides those of the graph.
    pub(super) positions: &'a [DVec3],
}

impl std::ops::Deref for GraphBefore<'_> {
    type Target = MeshGraph;

    fn deref(&self) -> &MeshGraph {
        self.graph
    }
}

/// An edit that changes more points than this part of them is for a new graph.
pub(super) const MOST_CHANGED: f64 = 0.25;

/// Which points an edit changes.
pub(super) struct ChangedPoints {
    /// How many old points are left.
    pub(super) kept: usize,
    pub(super) new_from_old: Vec<u32>,
    /// Old points that are gone, rising.
    pub(super) gone: Vec<u32>,
    /// By new number: whether an old point has a new place.
    pub(super) moved: Vec<bool>,
    /// New numbers of points that are new, moved, or have a face that is new, gone or of another shape; rising.
    pub(super) fans: Vec<u32>,
}

impl ChangedPoints {
    /// `None` when the numbers do not fit together, or too much changed.
    pub(super) fn from_change(old: &GraphBefore<'_>, change: &MeshChange) -> Option<Self> {
        let kept = change.old_from_new.partition_point(|&o| o != NONE);
        let mut new_from_old = vec![NONE; old.surface];
        for (new, &o) in (0u32..).zip(&change.old_from_new[..kept]) {
            new_from_old[o as usize] = new;
        }
        let gone: Vec<u32> = (0u32..)
            .zip(&new_from_old)
            .filter(|n| *n.1 == NONE)
            .map(|n| n.0)
            .collect();
        if change.old_from_new.len() != change.positions.len()
            || !change.old_from_new[..kept].is_sorted()
            || old.surface - gone.len() != kept
        {
            return None;
        }
        let mut fans: Vec<u32> = (kept as u32..change.positions.len() as u32).collect();
        let added = change.added.iter().flat_map(|&t| change.triangles[t as usize]);
        fans.extend(added);
        let removed = change.removed.iter().flatten().map(|&o| new_from_old[o as usize]);
        fans.extend(removed.filter(|&n| n != NONE));
        let mut moved = vec![false; change.positions.len()];
        for &p in change.moved {
            moved[p as usize] = true;
            fans.push(p);
            let around = old.row(change.old_from_new[p as usize]).iter();
            let around = around.take_while(|&&o| (o as usize) < old.surface);
            fans.extend(around.map(|&o| new_from_old[o as usize]).filter(|&n| n != NONE));
        }
        fans.sort_unstable();
        fans.dedup();
        let most = MOST_CHANGED * old.surface.max(change.positions.len()) as f64;
        let changed = fans.len().max(gone.len());
        (changed as f64 <= most).then_some(Self {
            kept,
            new_from_old,
            gone,
            moved,
            fans,
        })
    }
}

/// Numbers of nodes while an edit is followed: old nodes have their own; new ones are numbered on from there, points,
/// then shell nodes, then lattice nodes.
pub(super) struct NodeNumbers {
    pub(super) old: u32,
    pub(super) points: u32,
    pub(super) shells: u32,
    pub(super) lattice: u32,
}

impl NodeNumbers {
    /// A new shell node.
    pub(super) fn add_shell_node(&mut self) -> u32 {
        self.shells += 1;
        self.old + self.points + self.shells - 1
    }

    /// A new lattice node; no shell nodes may follow.
    pub(super) fn add_lattice_node(&mut self) -> u32 {
        self.lattice += 1;
        self.old + self.points + self.shells + self.lattice - 1
    }
}

impl NodeNumbers {
    pub(super) fn from_change(old: &GraphBefore<'_>, change: &MeshChange, points: &ChangedPoints) -> Self {
        Self {
            old: old.nodes() as u32,
            points: (change.positions.len() - points.kept) as u32,
            shells: 0,
            lattice: 0,
        }
    }

    /// The number of a point.
    pub(super) fn point_number(&self, change: &MeshChange, new: u32) -> u32 {
        match change.old_from_new[new as usize] {
            NONE => self.old + new - (change.positions.len() as u32 - self.points),
            o => o,
        }
    }
}

/// An edge between two nodes, numbered as in [`NodeNumbers`].
#[derive(Debug, Clone, Copy)]
pub(super) struct NewEdge {
    pub(super) ends: [u32; 2],
    pub(super) weight: f32,
}

impl NewEdge {
    pub(super) fn new(a: u32, b: u32) -> Self {
        Self {
            ends: [a, b],
            weight: 1.0,
        }
    }
}

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
