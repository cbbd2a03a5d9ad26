//! Where the soles of a figure's feet are.

use super::bones::MotionRig;
use super::legs::Leg;
use glam::DVec3;
use pliant_mesh::query::closest_point::closest_point_on_segment;
use std::f64::consts::{FRAC_PI_6, TAU};

/// How far from a foot's bone its vertices are at most, over the bone's length.
const REACH: f64 = 1.5;
/// Directions around the vertical in which the outermost vertices of a sole are kept, and how many steps of 30 degrees down.
const AROUND: u32 = 12;
const DOWN: u32 = 3;

/// The vertices on which a foot can stand, in the rest pose: the outermost ones below its ankle, of those nearest to its bone or to what
/// hangs on it. Empty without any, or for a leg without a foot.
pub(super) fn sole_points(rig: &MotionRig, leg: &Leg, rest: &[DVec3]) -> Vec<DVec3> {
    let Some(foot) = leg.foot else {
        return Vec::new();
    };
    let up = rig.up.direction();
    let (from, to) = (rig.bones[foot].from, rig.bones[foot].to);
    let reach = REACH * from.distance(to);
    let mut is_foot = vec![false; rig.bones.len()];
    for (number, bone) in rig.bones.iter().enumerate() {
        is_foot[number] = number == foot || bone.parent.is_some_and(|parent| is_foot[parent]);
    }
    let far = |p: DVec3, bone: usize| {
        let own = &rig.bones[bone];
        closest_point_on_segment(p, own.from, own.to).distance_squared(p)
    };
    let is_of_foot = |p: &&DVec3| {
        if (**p - from).dot(up) > 0.0 || far(**p, foot) > reach * reach {
            return false;
        }
        let all = (0..rig.bones.len()).map(|bone| (far(**p, bone), !is_foot[bone]));
        let nearest = all.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest.is_some_and(|nearest| !nearest.1)
    };
    let own: Vec<DVec3> = rest.iter().filter(is_of_foot).copied().collect();
    let side = up.any_orthonormal_vector();
    let other = up.cross(side);
    let mut found: Vec<DVec3> = Vec::new();
    for step in 0..AROUND * DOWN {
        let turn = TAU * f64::from(step % AROUND) / f64::from(AROUND);
        let down = FRAC_PI_6 * f64::from(step / AROUND + 1);
        let level = side * libm::cos(turn) + other * libm::sin(turn);
        let way = level * libm::cos(down) - up * libm::sin(down);
        let outermost = own.iter().max_by(|a, b| a.dot(way).total_cmp(&b.dot(way)));
        if let Some(p) = outermost.filter(|p| !found.contains(p)) {
            found.push(*p);
        }
    }
    found
}
