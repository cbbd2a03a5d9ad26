//! A clip: how the joints of a skeleton move over time.

use super::curve::KeyedCurve;
use super::skeleton::{JointPose, Skeleton};
use glam::{DQuat, DVec3};

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
