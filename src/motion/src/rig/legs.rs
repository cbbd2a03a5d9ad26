//! The legs of a rig: which of its bones a clip's legs turn.

use super::bones::MotionRig;
use crate::humanoid::{bones_of_names, bones_of_shape};
use crate::skeleton::Skeleton;
use glam::DVec3;

/// Numbers of the bones of a leg, each hanging on the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Leg {
    /// From the hip to the knee.
    pub thigh: usize,
    /// From the knee to the ankle.
    pub shin: usize,
    /// From the ankle on, where the rig has it.
    pub foot: Option<usize>,
}

impl Leg {
    /// The legs of a rig that a skeleton's legs turn, the left one first. Legs of a skeleton are known by the names of its joints, else
    /// by how it branches. A leg whose bones do not hang on each other is left out.
    pub fn all_of(rig: &MotionRig, skeleton: &Skeleton) -> Vec<Self> {
        let Some(named) = bones_of_names(skeleton).ok().or_else(|| bones_of_shape(skeleton)) else {
            return Vec::new();
        };
        let turned_by = |id: &str| {
            let name = &skeleton.joints[*named.get(id)?].name;
            rig.bones.iter().position(|bone| bone.joint == *name)
        };
        let leg = |[thigh, shin, foot]: [&str; 3]| {
            let (thigh, shin) = (turned_by(thigh)?, turned_by(shin)?);
            let hangs_on = |bone: usize, above: usize| rig.bones[bone].parent == Some(above);
            let foot = turned_by(foot).filter(|foot| hangs_on(*foot, shin));
            hangs_on(shin, thigh).then_some(Self { thigh, shin, foot })
        };
        let sides = [["lThigh", "lShin", "lFoot"], ["rThigh", "rShin", "rFoot"]];
        sides.into_iter().filter_map(leg).collect()
    }

    /// The hip, the knee and the ankle in the rest pose.
    pub fn rest_joints(&self, rig: &MotionRig) -> [DVec3; 3] {
        let [thigh, shin] = [self.thigh, self.shin].map(|bone| &rig.bones[bone]);
        let ankle = self.foot.map_or(shin.to, |foot| rig.bones[foot].from);
        [thigh.from, shin.from, ankle]
    }
}
