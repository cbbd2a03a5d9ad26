//! The surface that a template is wrapped onto: what of it is seen, where it ends, and what is closest on it.

use super::normals::smooth_normals;
use super::similarity::Similarity;
use super::visible::seen_vertices;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use crate::mesh::{Adjacency, Mesh, signed_volume};
use glam::DVec3;

/// Of a vertex in no triangle that is seen.
pub(super) const NO_NORMAL: DVec3 = DVec3::ZERO;
/// How often normals are averaged with those around them: those of a scan are noisy.
const AVERAGED: usize = 2;

/// A target, where it was placed.
pub(super) struct TargetSurface {
    pub mesh: Mesh,
    /// Its triangles without those that cannot be seen from outside.
    pub seen: Vec<[u32; 3]>,
    /// By vertex, pointing outside.
    pub normals: Vec<DVec3>,
    /// By vertex, whether a border of the surface goes through it: an edge of one triangle that is seen. There the surface may go on
    /// where nothing was scanned.
    on_border: Vec<bool>,
    /// Whether it has a border.
    is_open: bool,
}

impl TargetSurface {
    /// Prepares a mesh.
    ///
    /// # Errors
    /// [`Error::Precondition`] where nothing of it is seen, [`Error::Cancelled`].
    pub fn of(mesh: Mesh, exec: &Exec<'_>) -> Result<Self, Error> {
        let mut triangles = mesh.triangles.clone();
        if signed_volume(&mesh.positions, &triangles) < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let normals = smooth_normals(&mesh.positions, &triangles);
        let is_seen = seen_vertices(&mesh.positions, &normals, &triangles, exec)?;
        let mut seen = triangles;
        seen.retain(|t| t.iter().any(|v| is_seen[*v as usize]));
        if seen.is_empty() {
            let problem = "nothing of the target can be seen from outside; are its triangles wound outwards?";
            return Err(Error::Precondition(problem.into()));
        }
        let adjacency = Adjacency::build(mesh.positions.len(), &seen);
        let mut on_border = vec![false; mesh.positions.len()];
        for edge in adjacency.edges.iter().filter(|edge| edge.faces() == 1) {
            edge.vertices.iter().for_each(|v| on_border[*v as usize] = true);
        }
        let mut normals = smooth_normals(&mesh.positions, &seen);
        let mut used = vec![false; mesh.positions.len()];
        seen.as_flattened().iter().for_each(|v| used[*v as usize] = true);
        for _ in 0..AVERAGED {
            let around = |v: usize| {
                let sum: DVec3 = adjacency
                    .neighbours
                    .of(v as u32)
                    .iter()
                    .map(|n| normals[*n as usize])
                    .sum();
                match used[v] {
                    true => (sum + normals[v]).normalize_or_zero(),
                    false => NO_NORMAL,
                }
            };
            normals = (0..normals.len()).map(around).collect();
        }
        Ok(Self {
            mesh,
            seen,
            normals,
            is_open: on_border.contains(&true),
            on_border,
        })
    }

    /// The same, elsewhere.
    pub fn moved(mut self, by: &Similarity) -> Self {
        self.mesh.positions.iter_mut().for_each(|p| *p = by.apply(*p));
        self.normals.iter_mut().for_each(|n| *n = by.turn(*n));
        self
    }

    /// A tree over what is seen.
    pub fn tree(&self, exec: &Exec<'_>) -> TriangleBvh<'_> {
        TriangleBvh::build(&self.mesh.positions, &self.seen, exec.pool)
    }

    /// Whether what is closest to a point, within a distance, is on a border.
    pub fn ends_at(&self, tree: &TriangleBvh<'_>, point: DVec3, within: f64) -> bool {
        if !self.is_open {
            return false;
        }
        let closest = tree.closest_point_within(point, within);
        closest.is_some_and(|found| self.has_border_at(found.triangle, found.point))
    }

    /// Whether a place of one of the triangles that are seen is on an edge or a corner whose ends are on the border.
    pub fn has_border_at(&self, triangle: u32, place: DVec3) -> bool {
        let corners = self.seen[triangle as usize];
        let weights = barycentric(place, corners.map(|v| self.mesh.positions[v as usize]));
        let is_outer = |k: usize| weights[k] > ON_EDGE;
        (0..3).all(|k| !is_outer(k) || self.on_border[corners[k] as usize]) && (0..3).any(|k| !is_outer(k))
    }

    /// Whether a vertex is on a border.
    pub fn is_on_border(&self, vertex: usize) -> bool {
        self.on_border[vertex]
    }
}

/// A point with a smaller weight of a corner is on the edge opposite.
const ON_EDGE: f64 = 1e-6;

/// The weights of the corners of a triangle at a point of it; those of the first corner for one without area.
pub(in crate::engine) fn barycentric(point: DVec3, [a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let normal = (b - a).cross(c - a);
    let whole = normal.length_squared();
    if whole == 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let of = |p: DVec3, q: DVec3| ((p - point).cross(q - point).dot(normal) / whole).clamp(0.0, 1.0);
    let (wb, wc) = (of(c, a), of(a, b));
    [(1.0 - wb - wc).clamp(0.0, 1.0), wb, wc]
}
