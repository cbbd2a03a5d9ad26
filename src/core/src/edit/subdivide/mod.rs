//! Each triangle of a region into four.
//!
//! Neighbours of the region that share a divided edge are split to fit (red and green triangles, Bank et al. 1983), so
//! there is no T-junction; where an edge has several render vertices at an end, each side gets its own middle at the
//! same point. [`SubdivisionScheme::Midpoint`] keeps the shape, [`SubdivisionScheme::Loop`] smooths it.

mod until_even;

pub use until_even::{EvennessTarget, FieldSample, subdivide_until_even};

use super::error::{EditSubject, Error};
use super::patch::{NewTriangle, NewVertex, SurfacePatch};
use super::region_mesh::RegionMesh;
use super::surface::SurfaceView;
use crate::mesh::NONE;
use crate::progress::{Progress, check};
use glam::DVec3;
use std::collections::BTreeMap;

/// Where new and old points come to lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SubdivisionScheme {
    /// New points in the middle of edges; old ones stay.
    Midpoint,
    /// The masks of Loop (1987): old points move as well, but for those on the rim of the region. Boundaries follow the
    /// cubic curve of their own points.
    Loop,
}

/// Divides `faces`, rising triangle numbers. Attributes of a new vertex are half and half those at the ends of its edge.
///
/// # Errors
/// [`Error::Invalid`] when `faces` is not a region or has no triangle with three points; [`Error::TooLarge`] beyond
/// what 32-bit numbers count; [`Error::Cancelled`].
pub fn subdivide_region(
    surface: &SurfaceView,
    faces: &[u32],
    scheme: SubdivisionScheme,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let mesh = RegionMesh::with_frozen_ring(surface, faces)?;
    let edges = mesh.edges();
    // Six list entries a triangle must be countable with 32 bits, see `mesh::Mesh::build`.
    let limit = u64::from(NONE / 6);
    let seen = surface.triangles.len() as u64 + 4 * faces.len() as u64;
    if seen > limit {
        return Err(Error::TooLarge {
            what: "triangles",
            seen,
            limit,
        });
    }
    if edges.is_empty() {
        let problem = "it holds no triangle with three different points";
        return Err(Error::invalid(EditSubject::Region, problem));
    }
    let check_at = |k: usize| match k.is_multiple_of(4096) {
        true => check(progress),
        false => Ok(()),
    };
    let mut middles = Vec::with_capacity(edges.len());
    for (k, &(a, b)) in edges.iter().enumerate() {
        check_at(k)?;
        middles.push(match scheme {
            SubdivisionScheme::Midpoint => until_even::edge_middle(&mesh, a, b),
            SubdivisionScheme::Loop => until_even::place_new_point(&mesh, a, b),
        });
    }
    let mut division = Subdivision {
        surface,
        mesh: &mesh,
        middles,
        edges: &edges,
        points: vec![NONE; edges.len()],
        vertices: BTreeMap::new(),
        patch: SurfacePatch::default(),
        next_point: surface.points,
    };
    for f in 0..mesh.faces.len() as u32 {
        check_at(f as usize)?;
        division.divide_face(f);
    }
    let mut patch = division.patch;
    patch.removed.sort_unstable();
    if scheme == SubdivisionScheme::Loop {
        for (p, point) in (0u32..).zip(&mesh.points) {
            check_at(p as usize)?;
            if let Some(to) = until_even::place_old_point(&mesh, p).filter(|to| *to != point.position) {
                patch.moved.push((point.old, to));
            }
        }
        patch.moved.sort_unstable_by_key(|m| m.0);
    }
    Ok(patch)
}

struct Subdivision<'a> {
    surface: &'a SurfaceView<'a>,
    mesh: &'a RegionMesh,
    /// The divided edges, sorted, and where their new points are.
    edges: &'a [(u32, u32)],
    middles: Vec<DVec3>,
    /// The number of each edge's new point, once it has one.
    points: Vec<u32>,
    /// The new vertex between two render vertices, the smaller first.
    vertices: BTreeMap<(u32, u32), u32>,
    patch: SurfacePatch,
    next_point: u32,
}

impl Subdivision<'_> {
    /// Replaces face `f` when at least one of its edges is divided.
    fn divide_face(&mut self, f: u32) {
        let face = self.mesh.faces[f as usize];
        let p = face.points;
        let corners = face.wedges.map(|w| self.mesh.wedges[w as usize].vertex);
        // The new vertex opposite to each corner.
        let mut middle = [None; 3];
        for i in 0..3 {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let key = (p[j].min(p[k]), p[j].max(p[k]));
            if let Ok(edge) = self.edges.binary_search(&key) {
                middle[i] = Some(self.middle_vertex(edge, corners[j], corners[k], face.primitive));
            }
        }
        if middle == [None; 3] {
            return;
        }
        self.patch.removed.push(self.mesh.triangles[f as usize]);
        let made = self.cut_into_pieces(corners, middle);
        self.patch.triangles.extend(made.into_iter().map(|corners| NewTriangle {
            primitive: face.primitive,
            corners,
        }));
    }

    /// What a triangle falls into when some sides have a new vertex, named by the corner opposite to them.
    fn cut_into_pieces(&self, corners: [u32; 3], middle: [Option<u32>; 3]) -> Vec<[u32; 3]> {
        if let [Some(x), Some(y), Some(z)] = middle {
            let [a, b, c] = corners;
            return vec![[a, z, y], [b, x, z], [c, y, x], [x, y, z]];
        }
        // Turned so that the side opposite to the first corner is divided and that opposite to the second is not.
        let turn = (0..3).find(|&i| middle[i].is_some() && middle[(i + 1) % 3].is_none());
        let Some(i) = turn else { return Vec::new() };
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let [a, b, c] = [corners[i], corners[j], corners[k]];
        match (middle[i], middle[k]) {
            (Some(x), None) => vec![[a, b, x], [a, x, c]],
            // A triangle at b, and a quad by its shorter diagonal.
            (Some(x), Some(z)) => {
                let at = |v: u32| self.surface.positions[v as usize];
                let (ax, zc) = ((at(b) + at(c)) * 0.5 - at(a), (at(a) + at(b)) * 0.5 - at(c));
                if ax.length_squared() <= zc.length_squared() {
                    vec![[b, x, z], [a, z, x], [a, x, c]]
                } else {
                    vec![[b, x, z], [a, z, c], [z, x, c]]
                }
            }
            _ => Vec::new(),
        }
    }

    fn middle_vertex(&mut self, edge: usize, v: u32, w: u32, primitive: u32) -> u32 {
        let old = self.surface.positions.len() as u32;
        let key = (v.min(w), v.max(w));
        *self.vertices.entry(key).or_insert_with(|| {
            let point = &mut self.points[edge];
            if *point == NONE {
                *point = self.next_point;
                self.next_point += 1;
            }
            self.patch.vertices.push(NewVertex {
                primitive,
                point: *point,
                position: self.middles[edge],
                of: [key.0, key.1, key.0],
                weights: [0.5, 0.5, 0.0],
            });
            old + self.patch.vertices.len() as u32 - 1
        })
    }
}
