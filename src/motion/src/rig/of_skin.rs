//! The rig of a skinned model: its joints are the rig's, and their vertices give the thickness of limbs.

use super::bones::{MotionRig, ReferencePose, RestAttitude, RigBone, RigError};
use crate::scene_motion::NodeOrder;
use crate::signed_axis::SignedAxis;
use crate::skeleton::MotionClip;
use glam::DVec3;
use pliant_asset::MovingScene;
use pliant_mesh::query::closest_point::closest_point_on_segment;

/// How far beyond the middle of its vertices a bone ends on which none follows, in units of the way there.
const LEAF_LENGTH: f64 = 1.6;
/// A bone's length over its radius from which on its rotations are parted into slices.
const SLENDER: f64 = 3.0;
/// Into how many.
const SLICES: usize = 3;

/// Makes the rig of a skinned model. `rest` has one rest position per render vertex; `skeleton` is what
/// [`crate::clip_of_scene`] made of the same scene in the same order.
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
    // A joint that holds nothing, nor any joint below it, is not a bone.
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
            parent,
            rest: RestAttitude::Orientation,
            slices: if length > SLENDER * radius { SLICES } else { 1 },
            span: if length > 2.0 * radius {
                [0.15, 0.85]
            } else {
                [0.3, 0.7]
            },
            ..RigBone::along(&joints[joint].name, from, to, radius)
        });
    }
    Ok(MotionRig {
        bones,
        reference: ReferencePose::Rest,
        scale: Some(1.0),
        up: SignedAxis::Y,
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
