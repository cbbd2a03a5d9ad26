//! Joints in a tree, and poses of them.
//!
//! A clip: how the joints of a skeleton move over time.
//!
//! Which bones a vertex follows, and how much each.

use super::curve::KeyedCurve;
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

/// What a clip moves of a joint; what it does not move stays in the rest pose.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointCurves {
    /// Relative to the joint above, in units of the clip.
    pub translation: Option<KeyedCurve<DVec3>>,
    /// Relative to the joint above, of unit length.
    pub rotation: Option<KeyedCurve<DQuat>>,
    /// Along the joint's own axes.
    pub scale: Option<KeyedCurve<DVec3>>,
}

/// How the joints of a skeleton move over time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MotionClip {
    /// What it is called; may be empty.
    pub name: String,
    /// What moves.
    pub skeleton: Skeleton,
    /// One entry per joint.
    pub curves: Vec<JointCurves>,
    /// When it ends, in seconds.
    pub duration: f64,
    /// Frames and seconds between them, where it was recorded in frames.
    pub recorded: Option<RecordedFrames>,
    /// What was noticed, one line each.
    pub warnings: Vec<String>,
}

/// How a clip was recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedFrames {
    /// How many.
    pub count: usize,
    /// Seconds from one to the next.
    pub interval: f64,
}

impl MotionClip {
    /// Where every joint is at a time in seconds, relative to the joint above it. Before the beginning and after the end it stays
    /// as it is there.
    pub fn pose_at(&self, seconds: f64) -> Vec<JointPose> {
        let joints = self.skeleton.joints.iter().zip(&self.curves);
        joints
            .map(|(joint, curves)| JointPose {
                translation: value_or(&curves.translation, seconds, joint.rest.translation),
                rotation: value_or(&curves.rotation, seconds, joint.rest.rotation),
                scale: value_or(&curves.scale, seconds, joint.rest.scale),
            })
            .collect()
    }
}

impl MotionClip {
    /// Whether the first recorded frame is a pose of its own, as the T-pose that many recordings begin with: some joint turns
    /// from it to the second by more than 20 degrees, and by less than a third of that to the third.
    pub fn begins_apart(&self) -> bool {
        let Some(recorded) = self.recorded.filter(|r| r.count > 2) else {
            return false;
        };
        let [first, second, third] = [0.0, 1.0, 2.0].map(|k| self.pose_at(k * recorded.interval));
        let largest = |a: &[JointPose], b: &[JointPose]| {
            let turns = a.iter().zip(b).map(|(a, b)| {
                let cosine = a.rotation.dot(b.rotation).abs().min(1.0);
                2.0 * libm::acos(cosine)
            });
            turns.fold(0.0, f64::max)
        };
        let step = largest(&first, &second);
        step > 20f64.to_radians() && largest(&second, &third) < step / 3.0
    }
}

fn value_or<T: super::curve::CurveValue>(curve: &Option<KeyedCurve<T>>, seconds: f64, rest: T) -> T {
    curve.as_ref().map_or(rest, |curve| curve.value_at(seconds))
}

/// The bones that a vertex follows: at most eight, with weights that are not negative and add up to one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BoneInfluences {
    /// Numbers of the bones, heaviest first; those without weight are 0.
    pub bones: [u16; Self::MOST],
    /// Their weights.
    pub weights: [f64; Self::MOST],
}

impl BoneInfluences {
    /// The most bones that a vertex follows.
    pub const MOST: usize = 8;

    /// One bone alone.
    pub fn one(bone: u16) -> Self {
        Self {
            bones: [bone, 0, 0, 0, 0, 0, 0, 0],
            weights: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        }
    }

    /// The bones with weight, and their weights.
    pub fn iter(&self) -> impl Iterator<Item = (usize, f64)> + Clone + '_ {
        let all = self.bones.iter().zip(&self.weights);
        all.filter(|(_, w)| **w > 0.0).map(|(b, w)| (usize::from(*b), *w))
    }

    /// Puts pairs in order, the heaviest first and bones in rising order where weights are equal, and scales them to add up
    /// to one. Pairs beyond the eighth are left out. `None` without any weight.
    pub fn from_pairs(pairs: &mut [(u16, f64)]) -> Option<Self> {
        pairs.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let kept = &pairs[..pairs.len().min(Self::MOST)];
        let sum: f64 = kept.iter().map(|p| p.1).sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        let mut found = Self::default();
        for (k, (bone, weight)) in kept.iter().filter(|p| p.1 > 0.0).enumerate() {
            found.bones[k] = *bone;
            found.weights[k] = weight / sum;
        }
        Some(found)
    }

    /// The heaviest of them, at most `most`.
    #[must_use]
    pub fn cut_to(&self, most: usize) -> Self {
        let mut pairs: Vec<(u16, f64)> = self.iter().take(most).map(|(bone, w)| (bone as u16, w)).collect();
        Self::from_pairs(&mut pairs).unwrap_or(*self)
    }

    /// The weighted mean of what each bone does with a point.
    pub fn blend(&self, place: impl Fn(usize) -> DVec3) -> DVec3 {
        self.iter().map(|(bone, weight)| place(bone) * weight).sum()
    }
}
