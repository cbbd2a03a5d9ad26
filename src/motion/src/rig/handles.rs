//! Handles of a rig by the paper's recipe (section 7): rotations in cylinders along bones, positions in spheres at joints.
//!
//! Cylinders stay well inside and off the ends of bones, so that bends are spread over the surface around joints. A bone with
//! slices has several: its twist against its parent grows along it from nothing, and what its child twists about the same axis
//! (a hand that is turned over) runs back into it.

use super::bones::{MotionRig, RigBone};
use super::drive::RigPose;
use super::rigid_motion::{RigidMotion, half_way, rotation_about};
use glam::DVec3;

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
    Slice { bone: usize, at: f64 },
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
        add_cylinders(number, bone, &mut handles);
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

fn add_cylinders(number: usize, bone: &RigBone, handles: &mut Vec<RigHandle>) {
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
                    rotation: half_way(parent.rotation, own.rotation, pose.turns[bone].is_far),
                    ..own
                }
            }
            Follows::Slice { bone, at } => {
                let own = pose.bones[bone];
                let Some(axis) = rig.bones[bone].direction() else {
                    return own;
                };
                let turns = pose.turns[bone];
                let angle = at * turns.below - (1.0 - at) * turns.above;
                RigidMotion {
                    rotation: (own.rotation * rotation_about(axis, angle)).normalize(),
                    ..own
                }
            }
        }
    }
}
