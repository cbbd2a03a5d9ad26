//! A clip: how the joints of a skeleton move over time.

use super::curve::KeyedCurve;
use super::skeleton::{JointPose, Skeleton};
use glam::{DQuat, DVec3};

/// What a clip moves of a joint; what it does not move stays at rest.
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

fn value_or<T: super::curve::CurveValue>(curve: &Option<KeyedCurve<T>>, seconds: f64, rest: T) -> T {
    curve.as_ref().map_or(rest, |curve| curve.value_at(seconds))
}
