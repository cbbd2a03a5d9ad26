//! Edges of the lattice around an edit.

use crate::graph::recipe::InteriorRecipe;
use crate::graph::resample::change::GraphBefore;
use crate::graph::resample::change::NewEdge;
use crate::graph::resample::grid::{NodeTable, ZoneGrid, ZoneNode};
use crate::graph::resample::local::LocalMesh;
use crate::graph::volume::lattice_grid::CERTAIN;
use crate::graph::volume::neighbours::{LatticeKey, directions, toward};
use crate::graph::volume::shell::walk;
use crate::mesh::query::{TriangleBvh, VisitCount};
use glam::DVec3;

/// A place of the grid is taken by a moved node no further than this, in intervals.
pub(super) const TAKEN: f64 = 0.6;

/// An edge to a node that is gone goes to another no further from it than this, in intervals.
const INSTEAD: f64 = 0.75;

/// What one node's edges turned out to be.
#[derive(Default)]
pub(super) struct FoundEdges {
    pub(super) links: Vec<NewEdge>,
    /// Ways that lead out of the lattice: from which node, and whereto.
    pub(super) leaving: Vec<(u32, DVec3)>,
}

/// Finds edges of nodes near an edit.
pub(super) struct EdgeFinder<'a> {
    pub(super) old: &'a GraphBefore<'a>,
    pub(super) inside: &'a InteriorRecipe,
    /// The first old lattice node.
    pub(super) first: usize,
    pub(super) nodes: &'a [ZoneNode],
    /// How many of them are old; these rise.
    pub(super) kept: usize,
    pub(super) gone: &'a [u32],
    pub(super) grid: &'a ZoneGrid,
    pub(super) table: &'a NodeTable,
    pub(super) surface: &'a TriangleBvh<'a>,
    /// What is looked at without asking any structure.
    pub(super) looked: &'a VisitCount,
}

impl EdgeFinder<'_> {
    /// The edges of a node, and its ways out of the lattice.
    pub(super) fn find_edges(&self, index: u32) -> FoundEdges {
        let node = &self.nodes[index as usize];
        let mut edges = FoundEdges::default();
        if let Some(key) = node.key {
            self.along_grid(index, key, &mut edges);
        }
        if node.number < self.old.nodes() as u32 {
            self.as_before(index, &mut edges);
        }
        edges
    }

    /// Edges in the directions of the grid.
    fn along_grid(&self, index: u32, key: LatticeKey, edges: &mut FoundEdges) {
        let node = &self.nodes[index as usize];
        for direction in directions(self.inside.valence) {
            let there = toward(key, direction);
            if let Some(other) = self.table.fixed_node(there) {
                let partner = &self.nodes[other];
                // An edge between two nodes that are looked at is found from its smaller key.
                if partner.again && there < key {
                    continue;
                }
                let ends = if key < there { [node, partner] } else { [partner, node] };
                self.join_nodes(ends, index, other as u32, edges);
                continue;
            }
            let end = self.grid.position(there);
            match self
                .table
                .nearest_node(self.nodes, self.grid, end, TAKEN * self.inside.interval, false)
            {
                Some(other) => self.join_nodes([node, &self.nodes[other]], index, other as u32, edges),
                None => edges.leaving.push((index, end)),
            }
        }
    }

    /// Edges that an old node had to moved ones, or as a moved one.
    fn as_before(&self, index: u32, edges: &mut FoundEdges) {
        let node = &self.nodes[index as usize];
        for &m in self.old.row(node.number).iter().filter(|&&m| m as usize >= self.first) {
            if let Ok(other) = self.nodes[..self.kept].binary_search_by_key(&m, |n| n.number) {
                let partner = &self.nodes[other];
                let fixed = node.key.is_some() && partner.key.is_some();
                if !(fixed || partner.again && m < node.number) {
                    self.join_nodes([node, partner], index, other as u32, edges);
                }
            } else if self.gone.binary_search(&m).is_err() {
                // Beyond the faces looked at nothing changed.
                edges.links.push(NewEdge::new(node.number, m));
            } else if node.key.is_none() {
                let end = self.old.positions[m as usize];
                let within = INSTEAD * self.inside.interval;
                match self.table.nearest_node(self.nodes, self.grid, end, within, true) {
                    Some(other) if other != index as usize => {
                        self.join_nodes([node, &self.nodes[other]], index, other as u32, edges);
                    }
                    _ => edges.leaving.push((index, end)),
                }
            }
        }
    }

    /// Joins two nodes that see each other; else each that is looked at is to be tied to what stands between.
    fn join_nodes(&self, [a, b]: [&ZoneNode; 2], index: u32, other: u32, edges: &mut FoundEdges) {
        let clear = (a.clearance + b.clearance) * CERTAIN > a.at.distance(b.at);
        if clear || self.surface.first_hit(a.at, b.at, None).is_none() {
            edges.links.push(NewEdge::new(a.number, b.number));
            return;
        }
        edges.leaving.push((index, self.nodes[other as usize].at));
        if self.nodes[other as usize].again {
            edges.leaving.push((other, self.nodes[index as usize].at));
        }
    }

    /// The vertex of `local` nearest to where the way from a node to `end` leaves the inside.
    pub(super) fn crossed_vertex(&self, local: &LocalMesh, node: u32, end: DVec3) -> Option<u32> {
        let node = &self.nodes[node as usize];
        let way = end - node.at;
        // No face reaches into the clear ball around a node.
        let clear = node.clearance * CERTAIN / way.length();
        if clear >= 1.0 {
            return None;
        }
        let hit = self.surface.first_hit(node.at + way * clear, end, None)?;
        Some(walk(
            &local.positions,
            &local.adjacency,
            hit.vertex,
            hit.point,
            self.looked,
        ))
    }

    /// The vertex of `local` nearest to `end`, if it is as near as that of an end left out as too near to the surface
    /// can be.
    pub(super) fn vertex_beside(&self, local: &LocalMesh, end: DVec3) -> Option<u32> {
        let near = self
            .surface
            .closest_point_within(end, 1.5 * (self.inside.depth + self.inside.interval))?;
        Some(walk(
            &local.positions,
            &local.adjacency,
            near.vertex,
            near.point,
            self.looked,
        ))
    }
}
