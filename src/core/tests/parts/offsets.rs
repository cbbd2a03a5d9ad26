//! How far places of different parts that lay side by side have come apart.

use glam::{DMat3, DVec3};
use pliant_core::mesh::query::TriangleBvh;
use pliant_core::mesh::query::closest_point::closest_weights_on_triangle;
use pliant_core::mesh::{BoundingBox, Components, Mesh};
use pliant_core::pool::Pool;

/// A vertex, and a place on another part that lies beside it.
pub struct Neighbours {
    pub vertex: u32,
    corners: [u32; 3],
    shares: [f64; 3],
}

/// All vertices that lie within `reach` of another part, with the nearest place on each such part.
pub fn side_by_side(mesh: &Mesh, reach: f64, pool: &Pool) -> Vec<Neighbours> {
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    let mut triangles = vec![Vec::new(); parts.count];
    for t in &mesh.triangles {
        triangles[parts.of_vertex[t[0] as usize] as usize].push(*t);
    }
    let mut found = Vec::new();
    for (part, triangles) in (0u32..).zip(&triangles) {
        let tree = TriangleBvh::build(&mesh.positions, triangles, pool);
        let corners: Vec<DVec3> = triangles
            .iter()
            .flatten()
            .map(|&v| mesh.positions[v as usize])
            .collect();
        let bounds = BoundingBox::of(&corners);
        for (vertex, &p) in (0u32..).zip(&mesh.positions) {
            let outside = (bounds.min - p).max(p - bounds.max).max_element() > reach;
            if parts.of_vertex[vertex as usize] == part || outside {
                continue;
            }
            if let Some(near) = tree.closest_point_within(p, reach) {
                let corners = triangles[near.triangle as usize];
                let (shares, _) = closest_weights_on_triangle(p, corners.map(|v| mesh.positions[v as usize]));
                found.push(Neighbours {
                    vertex,
                    corners,
                    shares,
                });
            }
        }
    }
    found
}

/// How much each offset has changed, turned with the triangle that it begins at.
pub fn offset_errors(neighbours: &[Neighbours], rest: &[DVec3], now: &[DVec3]) -> Vec<f64> {
    let error = |n: &Neighbours| {
        let [before, after] = [rest, now].map(|at| {
            let t = n.corners.map(|v| at[v as usize]);
            let place = t[0] * n.shares[0] + t[1] * n.shares[1] + t[2] * n.shares[2];
            (frame(t), at[n.vertex as usize] - place)
        });
        match (before.0, after.0) {
            (Some(from), Some(to)) => (to * (from.transpose() * before.1)).distance(after.1),
            _ => (before.1.length() - after.1.length()).abs(),
        }
    };
    let mut errors: Vec<f64> = neighbours.iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

/// A triangle's own axes; `None` without an area.
fn frame([a, b, c]: [DVec3; 3]) -> Option<DMat3> {
    let normal = (b - a).cross(c - a).try_normalize()?;
    let along = (b - a).try_normalize()?;
    Some(DMat3::from_cols(along, normal.cross(along), normal))
}

/// The value that the given part of a rising list lies at or below.
pub fn quantile(sorted: &[f64], part: f64) -> f64 {
    let last = sorted.len().saturating_sub(1) as f64;
    sorted.get((part * last) as usize).copied().unwrap_or(0.0)
}
