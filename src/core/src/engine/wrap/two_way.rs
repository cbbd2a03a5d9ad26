//! Pulls from the target: what of it nothing of the template is near pulls the template's nearest vertices. Closest points alone never
//! find a hump that the template has not.

use super::facing::{FacingLimits, FacingTree, OrientedPoint};
use super::normals::smooth_normals;
use super::queries::answers;
use super::target::TargetSurface;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::query::{TriangleBvh, corner_near};
use glam::DVec3;

/// Nearer than this share of the farthest that counts, the closest points of the template are enough.
const NEAR: f64 = 0.05;

/// For vertices of the template, rising, the mean of what pulls them. `near` has, by vertex of the target, the triangle that the step
/// before found, and gets that of this step.
///
/// # Errors
/// Those of [`answers`].
pub(super) fn pulls_from_target(
    target: &TargetSurface,
    now: &[DVec3],
    triangles: &[[u32; 3]],
    reach: FacingLimits,
    near: &mut [Option<u32>],
    exec: &Exec<'_>,
) -> Result<Vec<(u32, DVec3)>, Error> {
    let normals = smooth_normals(now, triangles);
    let facing = FacingTree::new(TriangleBvh::build(now, triangles, exec.pool), &normals);
    let find = |vertex: usize| {
        let (point, normal) = (target.mesh.positions[vertex], target.normals[vertex]);
        if normal == DVec3::ZERO || target.is_on_border(vertex) {
            return None;
        }
        facing.closest(OrientedPoint { point, normal }, reach, near[vertex])
    };
    let found = answers(&facing.tree, target.mesh.positions.len(), exec, find)?;
    let mut pulls = Vec::new();
    for ((near, found), &from) in near.iter_mut().zip(found).zip(&target.mesh.positions) {
        *near = found.map(|f| f.triangle);
        if let Some(found) = found.filter(|f| f.point.distance(from) > NEAR * reach.within) {
            pulls.push((corner_near(now, triangles[found.triangle as usize], from), from));
        }
    }
    pulls.sort_by_key(|p| p.0);
    let mean = |of: &[(u32, DVec3)]| (of[0].0, of.iter().map(|p| p.1).sum::<DVec3>() / of.len() as f64);
    Ok(pulls.chunk_by(|a, b| a.0 == b.0).map(mean).collect())
}
