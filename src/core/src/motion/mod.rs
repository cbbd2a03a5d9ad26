//! Motion: skeletons, clips that move them, and where their joints are at a time (section 7 of the paper).

pub mod bvh;
pub mod correctives;
mod curve;
pub mod decomposition;
mod error;
pub mod humanoid;
pub mod rig;
mod scene_motion;
mod skeleton;
pub mod skin_weights;

pub use curve::{CurveValue, Interpolation, KeyedCurve, SplinePlace};
pub use error::Error;
pub use scene_motion::SceneMotion;
pub use scene_motion::{NodeOrder, clip_of_scene};
pub use skeleton::BoneInfluences;
pub use skeleton::{JointCurves, MotionClip, RecordedFrames};
pub use skeleton::{JointPose, Skeleton, SkeletonJoint};
