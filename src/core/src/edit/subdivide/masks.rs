//! Loop's masks ("Smooth Subdivision Surfaces Based on Triangles", 1987; boundaries after Hoppe et al. 1994).

use crate::edit::region_mesh::RegionMesh;
use glam::DVec3;
use std::f64::consts::TAU;

/// The middle of an edge.
pub(super) fn edge_middle(mesh: &RegionMesh, a: u32, b: u32) -> DVec3 {
    (mesh.position(a) + mesh.position(b)) * 0.5
}

/// The new point of an edge: between two faces of the region 3/8 of each end and 1/8 of each tip, else the middle.
pub(super) fn place_new_point(mesh: &RegionMesh, a: u32, b: u32) -> DVec3 {
    let edge = mesh.edge_faces(a, b);
    let tip = |f| mesh.opposite_corner(f, a, b).map(|p| mesh.position(p));
    if mesh.is_locked(edge) || edge.faces().count() != 2 {
        return edge_middle(mesh, a, b);
    }
    match (tip(edge.left), tip(edge.right)) {
        (Some(c), Some(d)) => (mesh.position(a) + mesh.position(b)) * 0.375 + (c + d) * 0.125,
        _ => edge_middle(mesh, a, b),
    }
}

/// Where an old point goes; `None` for one that stays because the faces around it are not all in the region, or make no
/// single fan.
pub(super) fn place_old_point(mesh: &RegionMesh, p: u32) -> Option<DVec3> {
    let point = &mesh.points[p as usize];
    if point.fixed {
        return None;
    }
    let around = mesh.neighbours(p);
    let rim: Vec<u32> = (around.iter().copied())
        .filter(|&q| mesh.edge_faces(p, q).faces().count() == 1)
        .collect();
    match (rim.as_slice(), around.len()) {
        ([], n @ 3..) => {
            let beta = neighbour_weight(n);
            let sum: DVec3 = around.iter().map(|&q| mesh.position(q)).sum();
            Some(point.position * (1.0 - n as f64 * beta) + sum * beta)
        }
        (&[a, b], _) => Some(point.position * 0.75 + (mesh.position(a) + mesh.position(b)) * 0.125),
        _ => None,
    }
}

/// The weight of each of `n` neighbours.
fn neighbour_weight(n: usize) -> f64 {
    let n = n as f64;
    let c = 0.375 + 0.25 * libm::cos(TAU / n);
    (0.625 - c * c) / n
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_are_those_of_the_paper() {
        assert!((neighbour_weight(3) - 3.0 / 16.0).abs() < 1e-15);
        assert!((neighbour_weight(6) - 1.0 / 16.0).abs() < 1e-15);
    }
}
