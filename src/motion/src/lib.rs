//! Motion: skeletons, clips that move them, and where their joints are at a time (section 7 of the paper).

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

pub mod bvh;
pub mod correctives;
mod curve;
pub mod decomposition;
pub mod humanoid;
pub mod rig;
mod scene_motion;
mod signed_axis;
mod skeleton;
pub mod skin_weights;

pub use curve::{CurveValue, Interpolation, KeyedCurve, SplinePlace};
pub use scene_motion::{NodeOrder, SceneMotion, clip_of_scene};
pub use signed_axis::SignedAxis;
pub use skeleton::{BoneInfluences, JointCurves, JointPose, MotionClip, RecordedFrames, Skeleton, SkeletonJoint};

/// Why a clip cannot be read. Lines count from 1.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The text is not a clip of this format.
    #[error("line {line}: {problem}")]
    Malformed {
        /// Where.
        line: usize,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// There is more of something than is allowed.
    #[error("the clip has {seen} {what}, at most {limit} are allowed")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        seen: u64,
        /// The limit.
        limit: u64,
    },
    /// There is nothing.
    #[error("the clip is empty; a BVH file begins with HIERARCHY")]
    Empty,
}
