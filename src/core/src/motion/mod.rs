//! Motion: skeletons, clips that move them, and where their joints are at a time (section 7 of the paper).

pub mod bvh;
mod clip;
pub mod correctives;
mod curve;
pub mod decomposition;
mod error;
pub mod humanoid;
mod influences;
mod of_scene;
pub mod rig;
mod scene_motion;
mod skeleton;
pub mod skin_weights;

pub use clip::{JointCurves, MotionClip, RecordedFrames};
pub use curve::{CurveValue, Interpolation, KeyedCurve, SplinePlace};
pub use error::Error;
pub use influences::BoneInfluences;
pub use of_scene::{NodeOrder, clip_of_scene};
pub use scene_motion::SceneMotion;
pub use skeleton::{JointPose, Skeleton, SkeletonJoint};
