//! Rigs of upright figures: where the joints of a body lie in a mesh, and which joints of a clip turn its bones.
//!
//! A body has the joints of [`BODY_JOINTS`] and the bones of [`BODY_BONES`]. [`bones_of_names`] finds which joints of a
//! clip turn which bone by their names, [`bones_of_shape`] by how the skeleton branches. [`find_body`] finds the joints
//! in a mesh of an upright figure, in a lattice of the cells that it occupies: hands are the ends farthest along it, arms are
//! between them and the trunk, a gap separates the legs. Each joint gets a score. [`rig_of_body`] combines both: it
//! moves joints of limbs to the middle of what is around them, and makes bones as thick as that is.

mod arms;
mod body_axes;
mod body_lattice;
mod body_search;
#[cfg(test)]
mod body_tests;
mod clip_bones;
mod figure;
mod figure_arms;
mod found_body;
mod joint_chain;
mod joint_scores;

use super::rig::{MotionRig, ReferencePose, RestAttitude, RigBone, RigError};
use super::skeleton::Skeleton;
pub use body_axes::BodyAxes;
pub use clip_bones::{BODY_BONES, BODY_JOINTS, BodyBone, ClipBones, bones_of_names, bones_of_shape, preset_skeleton};
pub use found_body::{BodyOrder, FoundBody, FoundJoint, find_body};
use glam::DVec3;
use pliant_mesh::graph::WindingTree;
use pliant_mesh::query::TriangleBvh;
use std::collections::BTreeMap;

/// A bone's radius over its length where it is unknown, and at least.
const UNKNOWN: f64 = 0.25;
const LEAST_RADIUS: f64 = 0.03;
/// How far apart, as a part of what joints are looked for in, places are that a joint in a gap may go to, and how many there are.
const NEAR_STEP: f64 = 0.01;
const NEAR_STEPS: u32 = 10;

/// A rig of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyRig {
    /// The rig.
    pub rig: MotionRig,
    /// The joints of its bones, by name.
    pub joints: Vec<PlacedJoint>,
}

/// The skeleton of a clip, and which of its joints turn the bones of a body.
#[derive(Debug, Clone, Copy)]
pub struct BodySkeleton<'a> {
    /// The skeleton.
    pub skeleton: &'a Skeleton,
    /// By bone of the body, the joint.
    pub bones: &'a ClipBones,
}

/// Makes a rig of a body's joints, given by name: joints of limbs not in `fixed` move to the middle of what is around
/// them. `tree` is that of the body's surface, `positions` are its vertices. Bones that no joint of `clip` turns are left
/// out, and their neighbours extend over them.
///
/// # Errors
/// [`RigError`] for joints of a body that are missing.
pub fn rig_of_body(
    tree: &WindingTree,
    positions: &[DVec3],
    joints: &BTreeMap<&'static str, DVec3>,
    fixed: &[&str],
    clip: BodySkeleton<'_>,
    reference: ReferencePose,
) -> Result<BodyRig, RigError> {
    let BodySkeleton { skeleton, bones: clip } = clip;
    let low = positions.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
    let high = positions.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
    let reach = 0.25 * (high - low).length();
    let kept: Vec<&BodyBone> = BODY_BONES.iter().filter(|bone| clip.contains_key(bone.id)).collect();
    for name in kept.iter().flat_map(|b| [b.from, b.to]) {
        if !joints.contains_key(name) {
            return Err(RigError::Field {
                field: "joints",
                problem: format!("\"{name}\" is not known, its place in the model is needed"),
            });
        }
    }
    let mut places = joints.clone();
    for (name, ends) in [
        ("lElbow", ["lShoulder", "lWrist"]),
        ("rElbow", ["rShoulder", "rWrist"]),
        ("lWrist", ["lElbow", "lHandEnd"]),
        ("rWrist", ["rElbow", "rHandEnd"]),
        ("lKnee", ["lHip", "lAnkle"]),
        ("rKnee", ["rHip", "rAnkle"]),
        ("lAnkle", ["lKnee", "lAnkle"]),
        ("rAnkle", ["rKnee", "rAnkle"]),
    ] {
        let [from, at, to] = [ends[0], name, ends[1]].map(|n| joints.get(n).copied());
        let (Some(from), Some(at), Some(to)) = (from, at, to) else {
            continue;
        };
        let axis = (to - from).try_normalize();
        if let Some(axis) = axis.filter(|_| !fixed.contains(&name)) {
            let middle = middle_of_section(tree.bvh(), at, axis, reach);
            places.insert(name, inside_near(tree, middle, axis, reach));
        }
    }
    let mut bones = Vec::with_capacity(kept.len());
    let mut parents = Vec::with_capacity(kept.len());
    for bone in &kept {
        let [from, to] = [places[bone.from], places[end_of(bone, clip)]];
        let length = from.distance(to);
        let radius = radius_of(tree, [from, to], reach).unwrap_or(UNKNOWN * length);
        let is_long = length > 2.0 * radius;
        bones.push(RigBone {
            joint: skeleton.joints[clip[bone.id]].name.clone(),
            aim: clip.get(bone.aim).map(|joint| skeleton.joints[*joint].name.clone()),
            rest: bone.rest,
            slices: if bone.is_limb { 3 } else { 1 },
            span: if is_long && bone.rest == RestAttitude::Direction {
                [0.15, 0.85]
            } else {
                [0.3, 0.7]
            },
            ..RigBone::along(
                bone.id,
                from,
                to,
                radius.max(LEAST_RADIUS * length).max(f64::MIN_POSITIVE),
            )
        });
        parents.push(parent_of(bone, clip).map(str::to_owned));
    }
    let mut reported: BTreeMap<&str, PlacedJoint> = BTreeMap::new();
    for name in kept.iter().flat_map(|b| [b.from, end_of(b, clip)]) {
        let at = places[name];
        reported.entry(name).or_insert_with(|| PlacedJoint {
            name: name.to_owned(),
            at,
            inside: tree.contains(at),
            moved: at.distance(joints[name]),
            score: 1.0,
            reason: String::new(),
        });
    }
    judge_inside(tree, [low, high], fixed, &mut reported);
    Ok(BodyRig {
        rig: MotionRig::from_named_parents(bones, &parents, reference, None)?,
        joints: reported.into_values().collect(),
    })
}

/// How far outside of a surface a joint may lie, over the size of the body: joints of figures of several parts lie in gaps.
const BESIDE: f64 = 0.02;
/// What is less deep than this part of its size is flat, and has no inside.
const FLAT: f64 = 0.05;
/// The score of a joint that lies outside.
const OUTSIDE: f64 = 0.4;

/// Lowers the scores of joints that lie outside of a body, beside its ends and those that were given. Where most do, the surface shows no
/// inside, and nothing follows from it unless the body is flat.
fn judge_inside(tree: &WindingTree, [low, high]: [DVec3; 2], fixed: &[&str], joints: &mut BTreeMap<&str, PlacedJoint>) {
    let extent = high - low;
    let is_end = |name: &str| name.ends_with("End") || name.ends_with("Toe") || fixed.contains(&name);
    let all = joints.len();
    let mut outside: Vec<&mut PlacedJoint> = joints
        .values_mut()
        .filter(|joint| !joint.inside && !is_end(&joint.name))
        .collect();
    let (is_flat, shows_none) = (
        extent.min_element() < FLAT * extent.max_element(),
        2 * outside.len() > all,
    );
    let beside = BESIDE * extent.max_element();
    for joint in &mut outside {
        let is_far = || !tree.bvh().has_triangle_within(joint.at, beside);
        if is_flat || (!shows_none && is_far()) {
            joint.score = OUTSIDE;
            joint.reason = match is_flat {
                true => "the model is flat, and has no inside".into(),
                false => "it lies outside of the model".into(),
            };
        }
    }
}

/// The joint where a bone ends: beyond those of the trunk that a clip lacks.
fn end_of(bone: &BodyBone, clip: &ClipBones) -> &'static str {
    let mut end = bone.to;
    for next in ["abdomen", "chest", "neck", "head"] {
        let own = BODY_BONES.iter().find(|b| b.id == next);
        if let Some(own) = own.filter(|own| own.from == end && !clip.contains_key(next) && next != "head") {
            end = own.to;
        }
    }
    end
}

/// The nearest bone above that the clip has.
fn parent_of(bone: &BodyBone, clip: &ClipBones) -> Option<&'static str> {
    let mut parent = bone.parent;
    while !parent.is_empty() {
        if clip.contains_key(parent) {
            return Some(parent);
        }
        parent = BODY_BONES.iter().find(|b| b.id == parent).map_or("", |b| b.parent);
    }
    None
}

/// How far the surface is around a bone.
fn radius_of(tree: &WindingTree<'_>, [from, to]: [DVec3; 2], reach: f64) -> Option<f64> {
    let axis = (to - from).try_normalize()?;
    let places = [0.3, 0.5, 0.7].map(|share| from.lerp(to, share));
    let mut met: Vec<f64> = places
        .iter()
        .filter_map(|p| thickness_at(tree.bvh(), *p, axis, reach))
        .collect();
    met.sort_by(f64::total_cmp);
    met.get(met.len() / 2).copied()
}

/// Rays around a joint.
const RAYS: usize = 24;
/// Times that a joint goes to the mean of what its rays meet.
const ROUNDS: usize = 4;
/// Rays that have to meet something.
const LEAST_HITS: usize = RAYS / 2;

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
    /// How sure its place is, 0 to 1; 1 for one that is given.
    pub score: f64,
    /// What speaks against it; empty where nothing does.
    pub reason: String,
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
fn middle_of_section(tree: &TriangleBvh<'_>, joint: DVec3, axis: DVec3, reach: f64) -> DVec3 {
    let mut at = joint;
    for _ in 0..ROUNDS {
        let rays = rays_across(tree, at, axis, reach);
        let met: Vec<DVec3> = rays.iter().filter_map(|(way, far)| far.map(|far| *way * far)).collect();
        if met.len() < LEAST_HITS {
            return joint;
        }
        // Rays are even in angle; opposite ones together give the middle between both walls.
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

/// A joint that lies in a gap, as between the shell of a shin and that of a boot, brought into what is nearest across its axis; any
/// other, and one with nothing near, as it is.
fn inside_near(tree: &WindingTree, joint: DVec3, axis: DVec3, reach: f64) -> DVec3 {
    if tree.contains(joint) {
        return joint;
    }
    let ways = rays_across(tree.bvh(), joint, axis, reach).map(|(way, _)| way);
    let step = NEAR_STEP * reach;
    let inside = |k: u32| {
        let place = |way: &DVec3| joint + *way * (f64::from(k) * step);
        ways.iter().map(place).find(|p| tree.contains(*p))
    };
    (1..=NEAR_STEPS).find_map(inside).unwrap_or(joint)
}

/// How far the surface is around a place on a bone; the median of its rays.
fn thickness_at(tree: &TriangleBvh<'_>, at: DVec3, axis: DVec3, reach: f64) -> Option<f64> {
    let mut met: Vec<f64> = rays_across(tree, at, axis, reach).iter().filter_map(|r| r.1).collect();
    met.sort_by(f64::total_cmp);
    (met.len() >= LEAST_HITS).then(|| met[met.len() / 2])
}
