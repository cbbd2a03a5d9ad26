//! Normals of vertices in double precision.

use crate::mesh::shading;
use glam::DVec3;

/// Unit normals by vertex; zero where there are none.
pub(super) fn smooth_normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let normals = shading::smooth_normals(positions, triangles);
    normals.into_iter().map(|n| n.as_dvec3().normalize_or_zero()).collect()
}
