//! Handles of a rig by the paper's recipe (section 7): rotations in cylinders along bones, positions in spheres at joints.
//!
//! Cylinders stay well inside and off the ends of bones, so that bends are spread over the surface around joints. A bone with
//! slices has several: its twist against its parent grows along it from nothing, and what its child twists about the same axis
//! (a hand that is turned over) runs back into it.
//!
//! The rig of a skinned model: its joints are the rig's, and their vertices give the thickness of limbs.
//!
//! Rigid motions as a turn about a point that goes somewhere.
//!
//! Turns split into a twist about an axis and a swing of that axis.

use super::bones::{MotionRig, ReferencePose, RestAttitude, RigBone, RigError};
use super::drive::RigPose;
use crate::asset::MovingScene;
use crate::mesh::query::closest_point::closest_point_on_segment;
use crate::motion::scene_motion::NodeOrder;
use crate::motion::skeleton::MotionClip;
use glam::{DQuat, DVec3};

/// A cylinder's radius over its bone's.
const CYLINDER: f64 = 0.25;
/// A joint's radius over the lesser of its bones'.
const JOINT: f64 = 0.25;
/// Where the sphere near the end of a bone lies on which none follows.
const LEAF: f64 = 0.8;

/// What holds the nodes of a handle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RigHandleShape {
    /// Rotations, within a distance of a segment.
    Cylinder {
        /// One end.
        from: DVec3,
        /// The other.
        to: DVec3,
        /// The distance.
        radius: f64,
    },
    /// Positions, within a sphere.
    Sphere {
        /// The centre.
        center: DVec3,
        /// The radius.
        radius: f64,
    },
}

/// How a handle moves with its bones.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Follows {
    /// The bone, less the part of its own twist that comes further along, and with the part of its child's that runs back.
    Slice { bone: usize, at: f64, child: Option<usize> },
    /// Where the bone begins, turned half-way between it and its parent.
    Joint { bone: usize },
    /// The bone.
    Bone { bone: usize },
}

/// A handle of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigHandle {
    /// What reports call it.
    pub name: String,
    /// What it holds.
    pub shape: RigHandleShape,
    follows: Follows,
}

/// The handles of a rig. Bones without length have no cylinder.
pub fn rig_handles(rig: &MotionRig) -> Vec<RigHandle> {
    let mut handles = Vec::new();
    for (number, bone) in rig.bones.iter().enumerate() {
        add_cylinders(rig, number, bone, &mut handles);
    }
    for (number, bone) in rig.bones.iter().enumerate() {
        let is_shared = rig.bones[..number].iter().any(|b| b.from == bone.from);
        if !is_shared {
            let parents = bone.parent.map_or(bone.radius, |p| rig.bones[p].radius);
            handles.push(RigHandle {
                name: format!("{} joint", bone.id),
                shape: RigHandleShape::Sphere {
                    center: bone.from,
                    radius: bone.joint_radius.unwrap_or(JOINT * bone.radius.min(parents)),
                },
                follows: Follows::Joint { bone: number },
            });
        }
        let is_leaf = rig.bones.iter().all(|b| b.parent != Some(number));
        if is_leaf && bone.from != bone.to {
            handles.push(RigHandle {
                name: format!("{} end", bone.id),
                shape: RigHandleShape::Sphere {
                    center: bone.from.lerp(bone.to, LEAF),
                    radius: bone.joint_radius.unwrap_or(JOINT * bone.radius),
                },
                follows: Follows::Bone { bone: number },
            });
        }
    }
    handles
}

fn add_cylinders(rig: &MotionRig, number: usize, bone: &RigBone, handles: &mut Vec<RigHandle>) {
    if bone.direction().is_none() {
        return;
    }
    let radius = CYLINDER * bone.radius;
    let at = |share: f64| bone.from.lerp(bone.to, share);
    let [low, high] = bone.span;
    if bone.slices < 2 {
        handles.push(RigHandle {
            name: bone.id.clone(),
            shape: RigHandleShape::Cylinder {
                from: at(low),
                to: at(high),
                radius,
            },
            follows: Follows::Bone { bone: number },
        });
        return;
    }
    let child = (rig.bones.iter().enumerate())
        .find(|(_, b)| b.parent == Some(number) && b.slices < 2)
        .map(|c| c.0);
    let count = bone.slices as f64;
    for slice in 0..bone.slices {
        let middle = (slice as f64 + 0.5) / count;
        // A third of the way to the next, so that twists have room between.
        let half = 1.0 / (6.0 * count);
        handles.push(RigHandle {
            name: format!("{} slice {}", bone.id, slice + 1),
            shape: RigHandleShape::Cylinder {
                from: at(middle - half),
                to: at(middle + half),
                radius,
            },
            follows: Follows::Slice {
                bone: number,
                at: middle,
                child,
            },
        });
    }
}

impl RigHandle {
    /// The bone along which it is one of several slices, and where it lies; `None` for what is not a slice.
    pub fn sliced_bone(&self) -> Option<(usize, DVec3)> {
        match (self.follows, self.shape) {
            (Follows::Slice { bone, .. }, RigHandleShape::Cylinder { from, to, .. }) => {
                Some((bone, from.lerp(to, 0.5)))
            }
            _ => None,
        }
    }

    /// Where a handle is in a pose of its rig, as the root bone sees it.
    pub fn motion(&self, rig: &MotionRig, pose: &RigPose) -> RigidMotion {
        match self.follows {
            Follows::Bone { bone } => pose.bones[bone],
            Follows::Joint { bone } => {
                let own = pose.bones[bone];
                let parent = rig.bones[bone].parent.map_or(own, |p| pose.bones[p]);
                RigidMotion {
                    rotation: half_way(parent.rotation, own.rotation),
                    ..own
                }
            }
            Follows::Slice { bone, at, child } => {
                let own = pose.bones[bone];
                let Some(axis) = rig.bones[bone].direction() else {
                    return own;
                };
                let twist = |below: RigidMotion, above: RigidMotion| {
                    twist_angle(above.rotation.inverse() * below.rotation, axis)
                };
                let grows = rig.bones[bone].parent.map_or(0.0, |p| twist(own, pose.bones[p]));
                let runs_back = child.map_or(0.0, |c| twist(pose.bones[c], own));
                let angle = at * runs_back - (1.0 - at) * grows;
                RigidMotion {
                    rotation: (own.rotation * rotation_about(axis, angle)).normalize(),
                    ..own
                }
            }
        }
    }
}

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

/// The angle in −π … π by which `rotation` twists about a unit axis: it is a swing of the axis after that twist. 0 where the
/// axis is reversed, so that the twist is undefined.
pub(super) fn twist_angle(rotation: DQuat, axis: DVec3) -> f64 {
    let (along, w) = (rotation.xyz().dot(axis), rotation.w);
    if along * along + w * w < 1e-12 {
        return 0.0;
    }
    let half = libm::atan2(along, w);
    let turn = std::f64::consts::TAU;
    // Half the angle is told up to half a turn.
    match 2.0 * half {
        angle if angle > 0.5 * turn => angle - turn,
        angle if angle < -0.5 * turn => angle + turn,
        angle => angle,
    }
}

/// A rotation by an angle about a unit axis.
pub(super) fn rotation_about(axis: DVec3, angle: f64) -> DQuat {
    let axis = axis * libm::sin(0.5 * angle);
    DQuat::from_xyzw(axis.x, axis.y, axis.z, libm::cos(0.5 * angle))
}

/// Half-way between two rotations, along the shorter way.
pub(super) fn half_way(a: DQuat, b: DQuat) -> DQuat {
    let sum = if a.dot(b) < 0.0 { a - b } else { a + b };
    match sum.length_squared() > 1e-12 {
        true => sum.normalize(),
        false => a,
    }
}

#[cfg(test)]
mod swing_twist_tests {
    use super::*;

    #[test]
    fn twist_and_swing_are_told_apart() {
        let (axis, across) = (DVec3::Z, DVec3::X);
        for angle in [-3.0, -1.2, 0.0, 0.4, 2.6, 3.1] {
            for bend in [-2.5, 0.0, 1.0] {
                for sign in [1.0, -1.0] {
                    let whole = rotation_about(across, bend) * rotation_about(axis, angle) * sign;
                    assert!((twist_angle(whole, axis) - angle).abs() < 1e-12, "{angle} {bend}");
                }
            }
        }
        assert_eq!(twist_angle(DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0), axis), 0.0);
    }
}
