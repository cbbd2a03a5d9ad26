//! Struts across places that are too thin for a lattice: each vertex is tied to the place that lies straight across, so that the two
//! sides keep their distance and turn together.

use crate::graph::error::Error;
use crate::graph::parallel::map;
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::spread::barycentric;
use glam::DVec3;

/// What a strut weighs that is as long as the square root of the area around its vertex, against edges of the surface, which
/// weigh 1: what a lattice would that fills the place.
const STIFFNESS: f64 = 10.0;
/// What one strut weighs at most.
const MOST: f64 = 8.0;
/// A strut meets the other side at no flatter angle than one with this sine.
const STEEP: f64 = 0.3;

/// An edge between two vertices that lie across from each other, the smaller one first, and its weight.
pub(in crate::graph) type Strut = ([u32; 2], f32);

/// The vertices that are to have struts, and how far across these may reach.
pub(in crate::graph) struct ThinPlaces<'a> {
    pub(in crate::graph) vertices: Vec<u32>,
    /// For each vertex of the mesh which way leads inwards.
    pub(in crate::graph) inward: &'a [DVec3],
    /// By part of the mesh.
    pub(in crate::graph) reach: &'a [f64],
    /// The area around each vertex of the mesh.
    pub(in crate::graph) areas: &'a [f64],
}

/// The struts of thin places; rising, each once. Edges of the mesh are none.
pub(in crate::graph) fn struts(site: &VolumeSite, thin: &ThinPlaces) -> Result<Vec<Strut>, Error> {
    if thin.vertices.is_empty() {
        return Ok(Vec::new());
    }
    // Built here, because that is never to be done by one of many in parallel.
    site.surface.tree();
    let found = map(&thin.vertices, site.budget, |&v| strut(site, thin, v))?;
    let mut all: Vec<Strut> = found.into_iter().flatten().flatten().filter(|s| s.1 > 0.0).collect();
    all.sort_by_key(|s| s.0);
    all.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    let neighbours = &site.adjacency.neighbours;
    all.retain(|&([a, b], _)| neighbours.of(a).binary_search(&b).is_err());
    Ok(all)
}

/// The edges from a vertex to the corners of the triangle straight across.
fn strut(site: &VolumeSite, thin: &ThinPlaces, v: u32) -> Option<[Strut; 3]> {
    let positions = &site.mesh.positions;
    let part = |v: u32| site.parts.components.of_vertex[v as usize];
    let (p, inward) = (positions[v as usize], thin.inward[v as usize]);
    let reach = thin.reach[part(v) as usize];
    if inward == DVec3::ZERO || reach == 0.0 {
        return None;
    }
    let tree = site.surface.tree().bvh();
    let hit = tree.first_hit(p, p + inward * reach, Some(v))?;
    let face = site.mesh.triangles[hit.triangle as usize];
    let corners = face.map(|v| positions[v as usize]);
    let normal = (corners[1] - corners[0])
        .cross(corners[2] - corners[0])
        .normalize_or_zero();
    let square = hit.point.distance_squared(p);
    if part(face[0]) != part(v) || normal.dot(inward).abs() < STEEP || square <= 0.0 {
        return None;
    }
    let shares = barycentric(corners, hit.point);
    // Edges to far corners are longer than the strut; together they have its energy.
    let squares = corners.map(|c| c.distance_squared(p));
    let longer: f64 = shares.iter().zip(squares).map(|(share, s)| share * s / square).sum();
    let weight = (STIFFNESS * thin.areas[v as usize] / square).min(MOST) / longer;
    Some([0, 1, 2].map(|k| {
        let other = face[k];
        ([v.min(other), v.max(other)], (weight * shares[k]) as f32)
    }))
}
