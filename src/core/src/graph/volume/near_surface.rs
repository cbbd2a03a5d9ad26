//! The surface as shell and lattice ask for it: by cells where its faces are of about one size, else by a tree.

use crate::graph::winding::tree::WindingTree;
use crate::mesh::Mesh;
use crate::mesh::query::{SegmentHit, TriangleBvh, TriangleCells};
use crate::pool::Pool;
use glam::DVec3;
use std::sync::OnceLock;

/// Side of a cell in mean edges.
const SIDE: f64 = 1.5;
/// Cells are no help to queries that reach further than this many of their sides.
const REACH: f64 = 4.0;

/// Answers whether there is room for a copy of a vertex.
pub(in crate::graph) trait RoomQueries {
    /// Whether any face is nearer to `point` than `radius`.
    fn has_face_within(&self, point: DVec3, radius: f64) -> bool;

    /// Whether the segment crosses any face but those around vertex `except`.
    fn is_way_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool;
}

impl RoomQueries for TriangleBvh<'_> {
    fn has_face_within(&self, point: DVec3, radius: f64) -> bool {
        self.has_triangle_within(point, radius)
    }

    fn is_way_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool {
        self.first_hit(from, to, except).is_some()
    }
}

/// The faces of a mesh, sorted for queries of short reach, and for all others when somebody asks.
pub(in crate::graph) struct NearSurface<'a> {
    positions: &'a [DVec3],
    faces: &'a [[u32; 3]],
    cells: Option<TriangleCells<'a>>,
    tree: OnceLock<WindingTree<'a>>,
    pool: &'a Pool,
}

impl<'a> NearSurface<'a> {
    /// Sorts the faces of a mesh for queries that reach about as far as its edges are long.
    pub(in crate::graph) fn sort(mesh: &'a Mesh, pool: &'a Pool) -> Self {
        let (positions, faces) = (&mesh.positions, &mesh.triangles);
        let perimeter = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            a.distance(b) + b.distance(c) + c.distance(a)
        };
        let total: f64 = faces.iter().map(perimeter).sum();
        let mean_edge = total / (3.0 * faces.len() as f64);
        Self {
            positions,
            faces,
            cells: TriangleCells::sort(positions, faces, SIDE * mean_edge, pool),
            tree: OnceLock::new(),
            pool,
        }
    }

    /// Takes the tree from now on where cells are no help to queries that reach `reach`.
    pub(in crate::graph) fn prepare_for(&mut self, reach: f64) {
        if !self.cells.as_ref().is_some_and(|cells| reach <= REACH * cells.side()) {
            self.cells = None;
            self.tree();
        }
    }

    /// The tree over all faces, which is built by the first who asks; that is never to be one of many in parallel.
    pub(in crate::graph) fn tree(&self) -> &WindingTree<'a> {
        let build = || WindingTree::build(self.positions, self.faces, self.pool);
        self.tree.get_or_init(build)
    }

    /// What long queries have looked at.
    pub(in crate::graph) fn visits(&self) -> u64 {
        let in_cells = self.cells.as_ref().map_or(0, TriangleCells::visits);
        in_cells + self.tree.get().map_or(0, |tree| tree.bvh().visits.total())
    }

    /// Lists all vertices, so that those next to each other in the list are close in space.
    pub(in crate::graph) fn vertices_in_space_order(&self) -> Vec<u32> {
        match &self.cells {
            Some(cells) => cells.vertices_in_space_order(),
            None => self.tree().bvh().vertices_in_space_order(),
        }
    }

    /// Finds the first face that the segment crosses or touches.
    pub(in crate::graph) fn first_hit(&self, from: DVec3, to: DVec3) -> Option<SegmentHit> {
        match &self.cells {
            Some(cells) => cells.first_hit(from, to),
            None => self.tree().bvh().first_hit(from, to, None),
        }
    }
}

impl RoomQueries for NearSurface<'_> {
    fn has_face_within(&self, point: DVec3, radius: f64) -> bool {
        match &self.cells {
            Some(cells) => cells.has_triangle_within(point, radius),
            None => self.tree().bvh().has_face_within(point, radius),
        }
    }

    fn is_way_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool {
        match &self.cells {
            Some(cells) => cells.is_crossed(from, to, except),
            None => self.tree().bvh().is_way_crossed(from, to, except),
        }
    }
}
