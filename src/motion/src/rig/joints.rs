//! The bones of a rig as joints of a skin.

use super::bones::{MotionRig, RigBone};
use super::drive::RigPose;
use super::handles::{RigHandle, rig_handles};
use super::rigid_motion::RigidMotion;
use crate::skin_weights::SkinBone;
use glam::{DMat3, DQuat, DVec3};
use pliant_asset::{NodePlace, PlayedJoint};

/// How nearly a bone may point along z where that axis defines its turn about itself.
const ALONG: f64 = 0.9;

/// The bones as vertices can follow them.
pub fn skin_bones(rig: &MotionRig) -> Vec<SkinBone> {
    let bone = |own: &RigBone| SkinBone {
        ends: [own.from, own.to],
        parent: own.parent,
    };
    rig.bones.iter().map(bone).collect()
}

/// A joint where each bone begins, named as the bone. Its y axis points along the bone and its z axis to the model's z as
/// nearly as it can, as Blender has bones.
pub fn rig_joints(rig: &MotionRig) -> Vec<PlayedJoint> {
    let joint = |own: &RigBone| PlayedJoint {
        name: own.id.clone(),
        parent: own.parent,
        rest: NodePlace {
            translation: own.from,
            rotation: bone_attitude(own),
        },
    };
    rig.bones.iter().map(joint).collect()
}

/// The joints of a rig's skin, and how a pose moves them.
#[derive(Debug, Clone)]
pub struct RigSkeleton {
    /// One for each bone, then one for each slice of a limb where twists are spread.
    pub joints: Vec<PlayedJoint>,
    slices: Vec<RigHandle>,
}

impl RigSkeleton {
    /// The joints of a rig; with `has_twists` limbs have joints along them among which their twists are spread.
    pub fn of_rig(rig: &MotionRig, has_twists: bool) -> Self {
        let mut joints = rig_joints(rig);
        let all = if has_twists { rig_handles(rig) } else { Vec::new() };
        let slices: Vec<RigHandle> = all
            .into_iter()
            .filter(|handle| handle.sliced_bone().is_some())
            .collect();
        for (bone, middle) in slices.iter().filter_map(RigHandle::sliced_bone) {
            let own = joints
                .iter()
                .filter(|j| j.parent == Some(bone) && j.name.contains(" twist "))
                .count();
            joints.push(PlayedJoint {
                name: format!("{} twist {}", rig.bones[bone].id, own + 1),
                parent: Some(bone),
                rest: NodePlace {
                    translation: middle,
                    rotation: joints[bone].rest.rotation,
                },
            });
        }
        Self { joints, slices }
    }

    /// The motion of each joint from its rest pose to `pose`, relative to the motion `frame`.
    pub fn motions_in(&self, rig: &MotionRig, pose: &RigPose, frame: &RigidMotion) -> Vec<RigidMotion> {
        let slices = self.slices.iter().map(|slice| slice.motion(rig, pose));
        let all = pose.bones.iter().copied().chain(slices);
        all.map(|motion| motion.followed_by(&pose.root).seen_from(frame))
            .collect()
    }
}

/// Where joints are that move as the bones do.
pub fn moved_joints(joints: &[PlayedJoint], motions: &[RigidMotion]) -> Vec<NodePlace> {
    let pairs = joints.iter().zip(motions);
    pairs
        .map(|(joint, motion)| NodePlace {
            translation: motion.place(joint.rest.translation),
            rotation: (motion.rotation * joint.rest.rotation).normalize(),
        })
        .collect()
}

fn bone_attitude(bone: &RigBone) -> DQuat {
    let Some(y) = bone.direction() else {
        return DQuat::IDENTITY;
    };
    let hint = if y.z.abs() < ALONG { DVec3::Z } else { DVec3::NEG_Y };
    let z = (hint - y * y.dot(hint)).normalize_or(DVec3::Z);
    DQuat::from_mat3(&DMat3::from_cols(y.cross(z), y, z)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::ReferencePose;
    use crate::signed_axis::SignedAxis;

    #[test]
    fn joints_point_along_their_bones_wherever_these_go() {
        for way in [DVec3::Y, DVec3::NEG_Y, DVec3::X, DVec3::Z, DVec3::new(-0.1, 0.2, -3.0)] {
            let rig = MotionRig {
                bones: vec![RigBone::along("b", DVec3::ONE, DVec3::ONE + way, 1.0)],
                reference: ReferencePose::Rest,
                scale: None,
                up: SignedAxis::Y,
            };
            let joint = &rig_joints(&rig)[0];
            assert!((joint.rest.rotation * DVec3::Y).distance(way.normalize()) < 1e-12);
            assert!((joint.rest.rotation.length() - 1.0).abs() < 1e-12);
        }
    }
}
