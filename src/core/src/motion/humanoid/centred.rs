//! The middle of what is around a joint, and how thick a bone is, by rays.

use crate::mesh::query::TriangleBvh;
use glam::DVec3;

/// Rays around a joint.
const RAYS: usize = 24;
/// Times that a joint goes to the mean of what its rays meet.
const ROUNDS: usize = 4;
/// Rays that have to meet something.
const LEAST: usize = RAYS / 2;

/// A joint where it was put.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedJoint {
    /// Its name.
    pub name: String,
    /// Where it lies, in model space.
    pub at: DVec3,
    /// Whether that is inside the model.
    pub inside: bool,
    /// How far it was moved to come to the middle, in model units.
    pub moved: f64,
}

/// Rays across an axis: how far each goes until it meets the surface; `None` for those that meet nothing.
fn rays_across(tree: &TriangleBvh<'_>, at: DVec3, axis: DVec3, reach: f64) -> [(DVec3, Option<f64>); RAYS] {
    let side = axis.any_orthonormal_vector();
    let other = axis.cross(side);
    std::array::from_fn(|k| {
        let angle = std::f64::consts::TAU * k as f64 / RAYS as f64;
        let way = side * libm::cos(angle) + other * libm::sin(angle);
        (
            way,
            tree.first_hit(at, at + way * reach, None).map(|hit| hit.along * reach),
        )
    })
}

/// The middle of the cross-section around a joint; the joint itself where the surface is not around it, or where the middle
/// lies farther away than the surface was.
pub(super) fn middle_of_section(tree: &TriangleBvh<'_>, joint: DVec3, axis: DVec3, reach: f64) -> DVec3 {
    let mut at = joint;
    for _ in 0..ROUNDS {
        let rays = rays_across(tree, at, axis, reach);
        let met: Vec<DVec3> = rays.iter().filter_map(|(way, far)| far.map(|far| *way * far)).collect();
        if met.len() < LEAST {
            return joint;
        }
        // Rays are even in angle; opposite ones together tell the middle between both walls.
        let mut shift = DVec3::ZERO;
        let mut pairs = 0.0;
        for k in 0..RAYS / 2 {
            if let (Some(a), Some(b)) = (rays[k].1, rays[k + RAYS / 2].1) {
                shift += rays[k].0 * (a - b);
                pairs += 1.0;
            }
        }
        if pairs == 0.0 {
            return joint;
        }
        at += shift / pairs;
    }
    let wall = thickness_at(tree, joint, axis, reach).unwrap_or(0.0);
    if at.distance(joint) > 1.5 * wall { joint } else { at }
}

/// How far the surface is around a place on a bone; the median of its rays.
pub(super) fn thickness_at(tree: &TriangleBvh<'_>, at: DVec3, axis: DVec3, reach: f64) -> Option<f64> {
    let mut met: Vec<f64> = rays_across(tree, at, axis, reach).iter().filter_map(|r| r.1).collect();
    met.sort_by(f64::total_cmp);
    (met.len() >= LEAST).then(|| met[met.len() / 2])
}
