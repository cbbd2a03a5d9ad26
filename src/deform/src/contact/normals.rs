//! Normals of a surface in a pose.

use glam::DVec3;
use pliant_mesh::Mesh;

/// Unit normals by vertex, averaged with those around `rounds` times.
pub(super) fn smooth_normals(mesh: &Mesh, at: &[DVec3], rounds: usize) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; at.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| at[v as usize]);
        let normal = (b - a).cross(c - a);
        triangle.iter().for_each(|v| normals[*v as usize] += normal);
    }
    let unit = |normals: Vec<DVec3>| normals.into_iter().map(DVec3::normalize_or_zero).collect::<Vec<_>>();
    normals = unit(normals);
    for _ in 0..rounds {
        let mut sums = vec![DVec3::ZERO; at.len()];
        for triangle in &mesh.triangles {
            let sum: DVec3 = triangle.iter().map(|v| normals[*v as usize]).sum();
            triangle.iter().for_each(|v| sums[*v as usize] += sum);
        }
        normals = unit(sums);
    }
    normals
}
