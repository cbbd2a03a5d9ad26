//! A small mesh of a region that can be changed edge by edge.
//!
//! [`gather`](Editable::gather) takes the faces of a region and, frozen, those that touch it; edges are then split,
//! collapsed and flipped; [`into_patch`](Editable::into_patch) says what became different. Topology is that of points;
//! each face corner names a *wedge*, the render vertex or blend of render vertices that it shows there. Points on the
//! rim of the region, and those around which the faces make no single fan, are fixed: nothing at them changes, so that
//! what lies outside does not notice. Knows lengths and angles, but no aim: what to change is the caller's.

mod change;
mod collapse;
mod emit;
mod gather;
pub(in crate::edit) mod triangle;

pub(in crate::edit) use collapse::Collapse;
pub(in crate::edit) use gather::{Bits, Touching, check_faces, proper_points};

use crate::mesh::NONE;
use crate::mesh::query::fan::is_single_oriented_fan;
use glam::DVec3;

/// A point and the faces around it.
#[derive(Debug, Clone)]
pub(in crate::edit) struct Point {
    pub position: DVec3,
    /// The surface's point that it is; [`NONE`] for one made or moved here.
    pub old: u32,
    /// Living faces with a corner here, in no order.
    pub faces: Vec<u32>,
    /// Whether the point and its faces' edges at it must stay.
    pub fixed: bool,
}

/// What a face corner shows at its point.
#[derive(Debug, Clone, Copy)]
pub(in crate::edit) struct Wedge {
    pub point: u32,
    pub primitive: u32,
    /// The render vertex that it is; [`NONE`] for a blend.
    pub old: u32,
    /// Render vertices that it is blended from, with their weights.
    pub of: [u32; 3],
    pub weights: [f64; 3],
}

/// A face; corners are wedges.
#[derive(Debug, Clone, Copy)]
pub(in crate::edit) struct Face {
    pub corners: [u32; 3],
    /// Points of the corners.
    pub points: [u32; 3],
    pub primitive: u32,
    /// The surface's triangle that it still is, else [`NONE`].
    pub old: u32,
    /// Outside the region: stays as it is.
    pub frozen: bool,
    pub alive: bool,
    /// A face, by its number at the start, that lies on the same side of all seams and features.
    pub source: u32,
}

/// The faces at an edge from `a` to `b`; [`NONE`] where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::edit) struct Edge {
    /// The face that passes from `a` to `b`.
    pub left: u32,
    /// The face that passes from `b` to `a`.
    pub right: u32,
    /// More than one face passes it the same way.
    pub tangled: bool,
}

impl Edge {
    /// The face that is there beside `f`.
    pub fn other(self, f: u32) -> Option<u32> {
        self.faces().find(|&g| g != f)
    }

    /// The faces that are there.
    pub fn faces(self) -> impl Iterator<Item = u32> {
        [self.left, self.right].into_iter().filter(|&f| f != NONE)
    }
}

/// See the module page.
#[derive(Debug, Clone, Default)]
pub(in crate::edit) struct Editable {
    pub points: Vec<Point>,
    pub wedges: Vec<Wedge>,
    pub faces: Vec<Face>,
    /// The surface's triangles that were gathered to be changed, rising.
    region: Vec<u32>,
    old_vertices: u32,
    old_points: u32,
}

impl Editable {
    /// Points at the corners of face `f`.
    pub fn points_of(&self, f: u32) -> [u32; 3] {
        self.faces[f as usize].points
    }

    /// Positions of the corners of face `f`.
    pub fn corners_of(&self, f: u32) -> [DVec3; 3] {
        self.points_of(f).map(|p| self.at(p))
    }

    /// Where point `p` is.
    pub fn at(&self, p: u32) -> DVec3 {
        self.points[p as usize].position
    }

    /// Distance of two points.
    pub fn length(&self, a: u32, b: u32) -> f64 {
        self.at(a).distance(self.at(b))
    }

    /// The faces at the edge from `a` to `b`.
    pub fn edge(&self, a: u32, b: u32) -> Edge {
        let mut edge = Edge {
            left: NONE,
            right: NONE,
            tangled: false,
        };
        for &f in &self.points[a as usize].faces {
            let p = self.points_of(f);
            for i in 0..3 {
                let side = if p[i] == a && p[(i + 1) % 3] == b {
                    &mut edge.left
                } else if p[i] == b && p[(i + 1) % 3] == a {
                    &mut edge.right
                } else {
                    continue;
                };
                edge.tangled |= *side != NONE;
                *side = f;
            }
        }
        edge
    }

    /// The wedge of face `f` at point `p`; `None` when `p` is none of its corners.
    pub fn wedge_at(&self, f: u32, p: u32) -> Option<u32> {
        let face = &self.faces[f as usize];
        (0..3).find(|&i| face.points[i] == p).map(|i| face.corners[i])
    }

    /// The corner of face `f` that is neither `a` nor `b`.
    pub fn across(&self, f: u32, a: u32, b: u32) -> Option<u32> {
        self.points_of(f).into_iter().find(|&p| p != a && p != b)
    }

    /// Whether the two faces at an edge show the same wedges along it.
    pub fn is_smooth(&self, edge: Edge, a: u32, b: u32) -> bool {
        edge.left != NONE
            && edge.right != NONE
            && [a, b]
                .into_iter()
                .all(|p| self.wedge_at(edge.left, p) == self.wedge_at(edge.right, p))
    }

    /// Whether an edge may not be changed at all: a face outside the region lies there, or more than two faces meet.
    pub fn is_locked(&self, edge: Edge) -> bool {
        edge.tangled || edge.faces().any(|f| self.faces[f as usize].frozen)
    }

    /// Whether the edge has a face of the region on either side and the same wedges on both.
    pub fn is_inside(&self, edge: Edge, a: u32, b: u32) -> bool {
        !self.is_locked(edge) && self.is_smooth(edge, a, b)
    }

    /// Points that share an edge with `p`, rising.
    pub fn neighbours(&self, p: u32) -> Vec<u32> {
        let faces = &self.points[p as usize].faces;
        let mut around: Vec<u32> = Vec::with_capacity(faces.len() + 4);
        for &f in faces {
            for q in self.points_of(f) {
                if q != p && !around.contains(&q) {
                    around.push(q);
                }
            }
        }
        around.sort_unstable();
        around
    }

    /// How many points share an edge with `p`, and how many faces are there: equal in the inside of a surface.
    pub fn valence(&self, p: u32) -> (usize, usize) {
        let faces = &self.points[p as usize].faces;
        // In a fan each neighbour is the next corner of one face, but the last of an open one.
        let next = |f: u32| {
            let q = self.points_of(f);
            (0..3).find(|&i| q[i] == p).map(|i| (q[(i + 1) % 3], q[(i + 2) % 3]))
        };
        let ends = faces.iter().filter(|&&f| {
            let last = next(f).map(|l| l.1);
            !faces.iter().any(|&g| next(g).map(|l| l.0) == last)
        });
        (faces.len() + ends.count(), faces.len())
    }

    /// Whether the faces around `p` make one fan, open or closed, that turns one way.
    pub fn is_single_fan(&self, p: u32) -> bool {
        let mut links: Vec<(u32, u32)> = Vec::new();
        for &f in &self.points[p as usize].faces {
            let q = self.points_of(f);
            if let Some(i) = q.iter().position(|&x| x == p) {
                links.push((q[(i + 1) % 3], q[(i + 2) % 3]));
            }
        }
        is_single_oriented_fan(&mut links)
    }

    /// All edges that the living faces of the region have, smaller end first, sorted.
    pub fn edges(&self) -> Vec<(u32, u32)> {
        let mut edges = Vec::with_capacity(self.faces.len() * 3);
        for (f, face) in self.faces.iter().enumerate() {
            if face.alive && !face.frozen {
                let p = self.points_of(f as u32);
                edges.extend((0..3).map(|i| (p[i].min(p[(i + 1) % 3]), p[i].max(p[(i + 1) % 3]))));
            }
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Numbers of the living faces of the region.
    pub fn living(&self) -> impl Iterator<Item = u32> {
        let faces = self.faces.iter().zip(0u32..);
        faces.filter(|(face, _)| face.alive && !face.frozen).map(|(_, f)| f)
    }
}
