//! The rig of a skinned model: its joints are the rig's, and their vertices give the thickness of limbs.
//!
//! How a clip is turned and scaled to stand as a model does.
//!
//! Rigid motions as a turn about a point that goes somewhere.

use super::bones::{MotionRig, ReferencePose, RestAttitude, RigBone, RigError};
use super::drive::rotation_about;
use crate::asset::MovingScene;
use crate::mesh::query::closest_point::closest_point_on_segment;
use crate::motion::scene_motion::NodeOrder;
use crate::motion::skeleton::MotionClip;
use glam::{DQuat, DVec3};

/// How far beyond the middle of its vertices a bone ends on which none follows, in units of the way there.
const LEAF_LENGTH: f64 = 1.6;
/// A bone's length over its radius from which on its rotations are parted into slices.
const SLENDER: f64 = 3.0;
/// Into how many.
const SLICES: usize = 3;

/// Makes the rig of a skinned model. `rest` has one rest position per render vertex; `skeleton` is what
/// [`crate::motion::clip_of_scene`] made of the same scene in the same order.
///
/// # Errors
/// [`RigError`] for a model without a skin that places it.
pub fn rig_of_skin(
    scene: &MovingScene,
    order: &NodeOrder,
    skeleton: &MotionClip,
    rest: &[DVec3],
) -> Result<MotionRig, RigError> {
    let joints = &skeleton.skeleton.joints;
    let world = skeleton.skeleton.world_transforms(&skeleton.skeleton.rest_pose());
    let held = vertices_of_joints(scene, order, joints.len(), rest);
    // A joint that holds nothing, nor any joint below it, is no bone.
    let mut matters: Vec<bool> = held.iter().map(|h| !h.is_empty()).collect();
    for joint in (0..joints.len()).rev() {
        if let Some(parent) = joints[joint].parent {
            matters[parent] |= matters[joint] && scene.is_joint[order.nodes[parent]];
        }
    }
    let chosen: Vec<usize> = (0..joints.len())
        .filter(|&j| matters[j] && scene.is_joint[order.nodes[j]])
        .collect();
    if chosen.is_empty() {
        return Err(RigError::field("rig", "the model has no skin; give a rig"));
    }
    let mut number = vec![None; joints.len()];
    chosen
        .iter()
        .enumerate()
        .for_each(|(k, &joint)| number[joint] = Some(k));
    let above = |joint: usize| -> Option<usize> {
        let mut at = joints[joint].parent;
        while let Some(parent) = at {
            if number[parent].is_some() {
                return number[parent];
            }
            at = joints[parent].parent;
        }
        None
    };
    let place = |joint: usize| world[joint].translation;
    let mut bones: Vec<RigBone> = Vec::with_capacity(chosen.len());
    for (k, &joint) in chosen.iter().enumerate() {
        // Of several roots the first has the others.
        let parent = above(joint).or((k > 0).then_some(0));
        let children = chosen.iter().filter(|&&c| above(c) == Some(k)).map(|&c| place(c));
        let from = place(joint);
        let to = end_of_bone(
            from,
            &children.collect::<Vec<_>>(),
            parent.map(|p| &bones[p]),
            &held[joint],
        );
        let radius = match thickness(from, to, &held[joint]) {
            Some(radius) => radius,
            None => parent.map_or(from.distance(to) * 0.25, |p| bones[p].radius),
        };
        let length = from.distance(to);
        let radius = if radius > 0.0 {
            radius
        } else {
            (0.25 * length).max(f64::MIN_POSITIVE)
        };
        bones.push(RigBone {
            id: joints[joint].name.clone(),
            parent,
            from,
            to,
            joint: joints[joint].name.clone(),
            aim: None,
            rest: RestAttitude::Orientation,
            radius,
            slices: if length > SLENDER * radius { SLICES } else { 1 },
            span: if length > 2.0 * radius {
                [0.15, 0.85]
            } else {
                [0.3, 0.7]
            },
            joint_radius: None,
            limit_degrees: None,
        });
    }
    Ok(MotionRig {
        bones,
        reference: ReferencePose::Rest,
        scale: Some(1.0),
    })
}

/// By joint the vertices that it holds more than any other does, with their weights.
fn vertices_of_joints(scene: &MovingScene, order: &NodeOrder, joints: usize, rest: &[DVec3]) -> Vec<Vec<(DVec3, f64)>> {
    let mut held = vec![Vec::new(); joints];
    for (vertex, &place) in rest.iter().enumerate() {
        let own = scene.influences.of(vertex).iter();
        let most = own.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        if let Some(&(node, weight)) = most {
            held[order.joints[node as usize]].push((place, f64::from(weight)));
        }
    }
    held
}

/// Where a bone ends: at the joint that follows it, of several at that which goes on straightest, at the end of what it holds
/// where none follows.
fn end_of_bone(from: DVec3, children: &[DVec3], parent: Option<&RigBone>, held: &[(DVec3, f64)]) -> DVec3 {
    let apart = children.iter().copied().filter(|c| *c != from);
    let straightest = |direction: DVec3| {
        let way = move |c: &DVec3| (*c - from).normalize().dot(direction);
        move |a: &DVec3, b: &DVec3| way(a).total_cmp(&way(b))
    };
    let middle = {
        let weight: f64 = held.iter().map(|h| h.1).sum();
        let sum: DVec3 = held.iter().map(|h| h.0 * h.1).sum();
        (weight > 0.0).then(|| sum / weight)
    };
    let found = match parent.and_then(RigBone::direction) {
        Some(direction) => apart.max_by(straightest(direction)),
        None => {
            let all: Vec<DVec3> = apart.collect();
            (!all.is_empty()).then(|| all.iter().sum::<DVec3>() / all.len() as f64)
        }
    };
    let leaf = || middle.map(|middle| from + (middle - from) * LEAF_LENGTH);
    found.or_else(leaf).unwrap_or(from)
}

/// The mean distance of what a bone holds from it.
fn thickness(from: DVec3, to: DVec3, held: &[(DVec3, f64)]) -> Option<f64> {
    let weight: f64 = held.iter().map(|h| h.1).sum();
    let distance = |p: DVec3| closest_point_on_segment(p, from, to).distance(p);
    (weight > 0.0).then(|| held.iter().map(|h| distance(h.0) * h.1).sum::<f64>() / weight)
}

/// Where a bone lies in the model and in the clip at its reference pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct BonePair {
    pub model: [DVec3; 2],
    /// The end is `None` for a joint whose end is unknown.
    pub clip: (DVec3, Option<DVec3>),
}

/// The turn about the vertical that lets a clip face as the model does: of all such turns the one that brings the clip's joints
/// nearest to the model's, both about their means. It is nothing where both are almost on one vertical line. A clip
/// that lies along z, such as one whose vertical is z, is turned upright before, where that brings it nearer.
pub(super) fn heading(pairs: &[BonePair]) -> Heading {
    let upright = turn_about_vertical(pairs.iter().flat_map(points_of).collect());
    let clip = || pairs.iter().flat_map(points_of).map(|p| p[1]);
    let low = clip().fold(DVec3::INFINITY, |a, p| a.min(p));
    let high = clip().fold(DVec3::NEG_INFINITY, |a, p| a.max(p));
    let (tall, long) = (high.y - low.y, high.z - low.z);
    let as_read = Heading {
        turn: upright.0,
        up: DVec3::Y,
    };
    if long <= LYING * tall {
        return as_read;
    }
    let stood = |p: DVec3| DVec3::new(p.x, p.z, -p.y);
    let standing = pairs.iter().flat_map(points_of).map(|[m, c]| [m, stood(c)]);
    let standing = turn_about_vertical(standing.collect());
    if standing.1 <= upright.1 {
        return as_read;
    }
    Heading {
        turn: standing.0 * rotation_about(DVec3::X, -std::f64::consts::FRAC_PI_2),
        up: DVec3::Z,
    }
}

/// How a clip is turned to stand as a model does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heading {
    /// From the clip's space to the model's.
    pub(super) turn: DQuat,
    /// The clip's axis that becomes the vertical.
    pub(super) up: DVec3,
}

/// How much longer a clip is along z than along y whose vertical may be z.
const LYING: f64 = 1.5;

/// The turn about the vertical that brings clip's points nearest to the model's, and how near they then are: larger is nearer.
fn turn_about_vertical(points: Vec<[DVec3; 2]>) -> (DQuat, f64) {
    let count = points.len().max(1) as f64;
    let [model_mean, clip_mean] = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<DVec3>() / count);
    let (mut along, mut across, mut size, mut level) = (0.0, 0.0, 0.0, 0.0);
    for [model, clip] in points {
        let (m, c) = (model - model_mean, clip - clip_mean);
        along += m.x * c.x + m.z * c.z;
        // Positive where the clip has to be turned from z towards x.
        across += m.x * c.z - m.z * c.x;
        level += m.y * c.y;
        size += m.length() * c.length();
    }
    let near = libm::hypot(along, across);
    if near <= 1e-6 * size {
        return (DQuat::IDENTITY, level);
    }
    (rotation_about(DVec3::Y, libm::atan2(across, along)), level + near)
}

fn points_of(pair: &BonePair) -> impl Iterator<Item = [DVec3; 2]> {
    let end = pair.clip.1.map(|end| [pair.model[1], end]);
    [Some([pair.model[0], pair.clip.0]), end].into_iter().flatten()
}

/// Model units for one unit of a clip: the lengths of the model's bones over those of the clip's. 1 where the clip's have none.
pub(super) fn scale(bones: &[RigBone], pairs: &[BonePair]) -> f64 {
    let (mut model, mut clip) = (0.0, 0.0);
    for (bone, pair) in bones.iter().zip(pairs) {
        let mut add = |[a, b]: [DVec3; 2], from: DVec3, to: DVec3| {
            let length = from.distance(to);
            if length > 0.0 {
                model += a.distance(b);
                clip += length;
            }
        };
        if let Some(end) = pair.clip.1 {
            add(pair.model, pair.clip.0, end);
        }
        if let Some(parent) = bone.parent.map(|p| &pairs[p]) {
            add([parent.model[0], pair.model[0]], parent.clip.0, pair.clip.0);
        }
    }
    match clip > 0.0 && model > 0.0 {
        true => model / clip,
        false => 1.0,
    }
}

/// Takes a point x to R (x − from) + to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidMotion {
    /// R, of unit length.
    pub rotation: DQuat,
    /// The point about which it turns, before.
    pub from: DVec3,
    /// Where that point goes.
    pub to: DVec3,
}

impl RigidMotion {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        from: DVec3::ZERO,
        to: DVec3::ZERO,
    };

    /// Where a point goes.
    pub fn place(&self, point: DVec3) -> DVec3 {
        self.rotation * (point - self.from) + self.to
    }

    /// Where a point comes from.
    pub fn place_back(&self, point: DVec3) -> DVec3 {
        self.rotation.inverse() * (point - self.to) + self.from
    }

    /// This motion, and then another.
    #[must_use]
    pub fn followed_by(&self, next: &Self) -> Self {
        Self {
            rotation: (next.rotation * self.rotation).normalize(),
            from: self.from,
            to: next.place(self.to),
        }
    }

    /// The motion as a point moved along with `frame` sees it: first this one, then back what `frame` did.
    ///
    /// ```
    /// use glam::{DQuat, DVec3};
    /// use pliant_core::motion::rig::RigidMotion;
    /// let turn = RigidMotion { rotation: DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0), from: DVec3::X, to: DVec3::Y };
    /// let seen = turn.seen_from(&turn);
    /// assert!(seen.place(DVec3::Z).distance(DVec3::Z) < 1e-15);
    /// ```
    #[must_use]
    pub fn seen_from(&self, frame: &Self) -> Self {
        let back = frame.rotation.inverse();
        Self {
            rotation: (back * self.rotation).normalize(),
            from: self.from,
            to: back * (self.to - frame.to) + frame.from,
        }
    }
}
