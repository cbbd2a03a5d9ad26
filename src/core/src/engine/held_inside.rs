//! What handles hold inside a model, carried over an edit.
//!
//! A region is a list of vertices after an edit, and lists do not tell what was held inside. Nodes that stay go on to be held
//! as they were; a body that is built anew has other nodes, and of each the nearest one before tells who holds it. Without
//! that, handles would reach further inside than before wherever their vertices are the nearest ones.

use super::handle::HandleSet;
use crate::deform::HandleSetup;
use crate::exec::Exec;
use crate::graph::MeshGraph;
use crate::mesh::NONE;
use crate::mesh::query::NearestPoints;
use glam::DVec3;
use rayon::prelude::*;
use std::borrow::Cow;

/// What the handles that an edit carried over held before it.
#[derive(Debug, Clone, Copy)]
pub(super) enum HeldBeforeEdit<'a> {
    /// The body has followed the edit.
    Followed {
        rigging: &'a HandleSetup,
        /// For each node its number before the edit, or [`NONE`].
        old_from_new: &'a [u32],
    },
    /// The body was built anew.
    Rebuilt(&'a HeldInside),
}

/// What handles hold inside a body that was built anew after an edit.
#[derive(Debug)]
pub(super) struct HeldInside {
    /// The handles that the edit carried over.
    pub set: HandleSet,
    /// By handle: interior nodes, rising.
    nodes: Vec<Vec<u32>>,
    /// Copies of vertices that the edit made, rising; they are held where their vertices are.
    copies: Vec<u32>,
}

impl HeldInside {
    /// What `rigging` held among nodes at `old`, of the nodes of a graph that was built anew.
    pub fn nearest(set: HandleSet, rigging: &HandleSetup, old: &[DVec3], graph: &MeshGraph, exec: &Exec<'_>) -> Self {
        let tree = NearestPoints::new(old.iter().copied().zip(0u32..));
        let shell = graph.surface + graph.stats.shell_nodes;
        let vertex_of = |copy: usize| graph.positions[graph.nearest_surface[copy] as usize];
        let is_copy_of_new = |n: usize| n < shell && tree.nearest(vertex_of(n)).is_none_or(|(_, away)| away > 0.0);
        let nearest: Vec<u32> = exec.pool.install(|| {
            let interior = (graph.surface..graph.nodes()).into_par_iter().with_min_len(1024);
            let found = interior.map(|n| match is_copy_of_new(n) {
                true => NONE,
                false => tree.nearest(graph.positions[n]).map_or(NONE, |(old, _)| old),
            });
            found.collect()
        });
        let interior = || (graph.surface as u32..).zip(&nearest);
        let held_by = |handle: &[u32]| {
            let held = interior().filter(|(_, was)| handle.binary_search(was).is_ok());
            held.map(|(n, _)| n).collect()
        };
        Self {
            set,
            nodes: rigging.handles.iter().map(|h| held_by(&h.nodes)).collect(),
            copies: interior().filter(|n| *n.1 == NONE).map(|(n, _)| n).collect(),
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let held: usize = self.nodes.iter().map(Vec::capacity).sum();
        (held + self.copies.capacity()) * 4
    }
}

impl<'a> HeldBeforeEdit<'a> {
    pub fn handle_count(&self) -> usize {
        match self {
            Self::Followed { rigging, .. } => rigging.handles.len(),
            Self::Rebuilt(inside) => inside.nodes.len(),
        }
    }

    /// What is held inside now, where the first `surface` nodes are vertices.
    pub fn held_inside(self, surface: u32) -> InteriorHolds<'a> {
        InteriorHolds {
            before: self,
            surface,
            new_from_old: match self {
                Self::Followed { old_from_new, .. } => new_from_old(old_from_new),
                Self::Rebuilt(_) => Vec::new(),
            },
        }
    }
}

/// For each node before the edit its number now.
fn new_from_old(old_from_new: &[u32]) -> Vec<u32> {
    let most = old_from_new.iter().filter(|o| **o != NONE).max();
    let mut new = vec![NONE; most.map_or(0, |&m| m as usize + 1)];
    for (n, &old) in (0u32..).zip(old_from_new).filter(|n| *n.1 != NONE) {
        new[old as usize] = n;
    }
    new
}

/// What handles go on to hold inside.
pub(super) struct InteriorHolds<'a> {
    before: HeldBeforeEdit<'a>,
    surface: u32,
    new_from_old: Vec<u32>,
}

impl InteriorHolds<'_> {
    /// Lets a handle go on to hold the nodes inside that it held: a list of vertices, as which it comes back, does not tell
    /// them.
    pub fn keep_inside(&self, handle: usize, nodes: &mut Vec<u32>) {
        let surface = self.surface;
        let still: Cow<'_, [u32]> = match self.before {
            HeldBeforeEdit::Followed { rigging, old_from_new } => {
                let is_new = |n: &u32| old_from_new.get(*n as usize).is_none_or(|o| *o == NONE);
                nodes.retain(|n| *n < surface || is_new(n));
                let held = rigging.handles[handle].nodes.iter();
                let still = held.filter_map(|&old| self.new_from_old.get(old as usize).copied());
                still.filter(|&n| n != NONE && n >= surface).collect()
            }
            HeldBeforeEdit::Rebuilt(inside) => {
                nodes.retain(|n| *n < surface || inside.copies.binary_search(n).is_ok());
                Cow::Borrowed(&inside.nodes[handle])
            }
        };
        nodes.extend_from_slice(&still);
        nodes.sort_unstable();
    }
}
