//! Joints in a tree, and poses of them.

use glam::{DAffine3, DQuat, DVec3};

/// A joint of a skeleton.
#[derive(Debug, Clone, PartialEq)]
pub struct SkeletonJoint {
    /// What it is called; may be empty, and several may share a name.
    pub name: String,
    /// Number of the joint that it hangs on, which is smaller than its own; `None` for a root.
    pub parent: Option<usize>,
    /// Its rest pose, relative to the joint above.
    pub rest: JointPose,
}

/// Where a joint is relative to the one above: scaled, then turned, then moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointPose {
    /// In units of the clip.
    pub translation: DVec3,
    /// Of unit length.
    pub rotation: DQuat,
    /// Along the joint's own axes.
    pub scale: DVec3,
}

impl JointPose {
    /// At a place, not turned.
    pub fn at(translation: DVec3) -> Self {
        Self {
            translation,
            rotation: DQuat::IDENTITY,
            scale: DVec3::ONE,
        }
    }

    /// As a transform into the space of the joint above.
    pub fn transform(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

/// Joints in a tree; parents come before their children.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Skeleton {
    /// All joints.
    pub joints: Vec<SkeletonJoint>,
}

impl Skeleton {
    /// The first joint of that name.
    pub fn joint_named(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|joint| joint.name == name)
    }

    /// The rest pose, one per joint.
    pub fn rest_pose(&self) -> Vec<JointPose> {
        self.joints.iter().map(|joint| joint.rest).collect()
    }

    /// Transforms from each joint's space into the space of the roots, for a pose with one entry per joint.
    ///
    /// # Panics
    /// When `pose` has fewer entries than there are joints.
    pub fn world_transforms(&self, pose: &[JointPose]) -> Vec<DAffine3> {
        let mut world: Vec<DAffine3> = Vec::with_capacity(self.joints.len());
        for (joint, own) in self.joints.iter().zip(&pose[..self.joints.len()]) {
            let above = joint.parent.map_or(DAffine3::IDENTITY, |parent| world[parent]);
            world.push(above * own.transform());
        }
        world
    }
}
