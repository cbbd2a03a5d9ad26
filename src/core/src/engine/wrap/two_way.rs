//! Pulls from the target: what of it nothing of the template is near pulls the template's nearest vertices. Closest points alone never
//! find a hump that the template has not.

use super::facing::{FacingTree, Reach};
use super::normals::smooth_normals;
use super::queries::answers;
use super::target::TargetSurface;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::query::{TriangleBvh, corner_near};
use glam::DVec3;

/// Nearer than this share of the farthest that counts, the closest points of the template are enough.
const NEAR: f64 = 0.05;

/// For vertices of the template, rising, the mean of what pulls them.
///
/// # Errors
/// Those of [`answers`].
pub(super) fn pulls_from_target(
    target: &TargetSurface,
    now: &[DVec3],
    triangles: &[[u32; 3]],
    reach: Reach,
    exec: &Exec<'_>,
) -> Result<Vec<(u32, DVec3)>, Error> {
    let normals = smooth_normals(now, triangles);
    let tree = TriangleBvh::build(now, triangles, exec.pool);
    let facing = FacingTree::new(&tree, &normals);
    let pull = |vertex: usize| {
        let (from, normal) = (target.mesh.positions[vertex], target.normals[vertex]);
        if normal == DVec3::ZERO || target.is_on_border(vertex) {
            return None;
        }
        let found = facing.closest(from, normal, reach)?;
        let is_far = found.point.distance(from) > NEAR * reach.within;
        is_far.then(|| (corner_near(now, triangles[found.triangle as usize], from), from))
    };
    let found = answers(&tree, target.mesh.positions.len(), exec, pull)?;
    let mut pulls: Vec<(u32, DVec3)> = found.into_iter().flatten().collect();
    pulls.sort_by_key(|p| p.0);
    let mean = |of: &[(u32, DVec3)]| (of[0].0, of.iter().map(|p| p.1).sum::<DVec3>() / of.len() as f64);
    Ok(pulls.chunk_by(|a, b| a.0 == b.0).map(mean).collect())
}
