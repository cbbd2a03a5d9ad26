//! What is asked for of an animation: its clip and rig, when its frames are, and how they are solved.

use crate::motion::MotionClip;
use crate::motion::bvh::ClipLimits;
use crate::motion::rig::MotionRig;
use bytes::Bytes;
use std::ops::Range;

/// Frames of one block.
pub const BLOCK_FRAMES: usize = 64;

/// Where the clip of an animation comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum ClipSource {
    /// From the model, by name or by number.
    OfModel(String),
    /// From a BVH file; `name` is used where the file names no clip.
    Bvh {
        /// What the clip is called; may be empty.
        name: String,
        /// The file.
        bytes: Bytes,
    },
}

/// How a clip drives a model. [`super::Animation::prepare`] prepares it.
#[derive(Debug, Clone)]
pub struct ClipRequest {
    /// The clip.
    pub clip: ClipSource,
    /// The rig that it drives; `None`: for a recording the one that [`super::make_rig`] makes, for a clip of the model that of its
    /// skin.
    pub rig: Option<MotionRig>,
    /// Which frames are wanted.
    pub frames: FrameChoice,
    /// Model units for one unit of the clip, in place of the rig's.
    pub scale: Option<f64>,
    /// How frames are solved.
    pub settings: AnimationSettings,
}

/// How large an animation may be.
#[derive(Debug, Clone, PartialEq)]
pub struct AnimationLimits {
    /// What a recorded clip may have.
    pub clip: ClipLimits,
    /// Its frames.
    pub frames: usize,
    /// Those of them that are wanted, times the vertices of the model.
    pub vertices: u64,
}

/// How rotations are fitted in the frames of an animation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnimationRefinement {
    /// The first frame is fitted 32 times, every other one goes on from what the frame before came to. Blocks but the first go on
    /// from a frame some way before their own, which is fitted 4 times.
    Carried,
    /// So many times in every frame, each from the blend of the handles' rotations. 0: the paper's two passes.
    Steps(u32),
}

/// How an animation is solved.
#[derive(Debug, Clone, PartialEq)]
pub struct AnimationSettings {
    /// Relative residual to reach, when asked for.
    pub tolerance: Option<f64>,
    /// Largest missing displacement as a fraction of the diagonal, when asked for.
    pub max_error: Option<f64>,
    /// How rotations are fitted.
    pub refinement: AnimationRefinement,
}

impl Default for AnimationSettings {
    fn default() -> Self {
        Self {
            tolerance: Some(1e-3),
            max_error: Some(1e-3),
            refinement: AnimationRefinement::Carried,
        }
    }
}

/// When the frames of an animation are, in seconds of its clip.
///
/// ```
/// use pliant_core::engine::FrameTimes;
/// let times = FrameTimes { start: 0.5, rate: 30.0, count: 31 };
/// assert_eq!((times.at(0), times.at(30)), (0.5, 1.5));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameTimes {
    /// When the first is.
    pub start: f64,
    /// Frames a second.
    pub rate: f64,
    /// How many there are.
    pub count: usize,
}

impl FrameTimes {
    /// Frames at `rate` from `start` to `end`, both included when they fall on a frame, or within a thousandth of one: files
    /// round the time between frames.
    pub fn between(start: f64, end: f64, rate: f64) -> Self {
        let intervals = ((end - start).max(0.0) * rate + 1e-3).floor();
        Self {
            start,
            rate,
            count: (intervals as usize).saturating_add(1),
        }
    }

    /// When a frame is.
    pub fn at(&self, frame: usize) -> f64 {
        self.start + frame as f64 / self.rate
    }
}

/// Frames a second of clips that were not recorded in frames.
const UNRECORDED_RATE: f64 = 30.0;

/// Which frames of a clip are wanted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameChoice {
    /// Frames a second, above 0; `None`: the clip's own, or 30 where it was not recorded in frames.
    pub fps: Option<f64>,
    /// Whether the first recorded frame, often a T-pose, is left out; `None`: where it is far from the second.
    pub skip_first: Option<bool>,
    /// The first one.
    pub first: usize,
    /// How many; `None`: all that follow.
    pub count: Option<usize>,
}

impl FrameChoice {
    /// Most frames a second.
    pub const FASTEST: f64 = 10_000.0;

    /// When all frames of a clip are.
    pub fn times(&self, clip: &MotionClip) -> FrameTimes {
        let recorded = clip.recorded.map_or(UNRECORDED_RATE, |r| 1.0 / r.interval);
        let skips = self.skip_first.unwrap_or_else(|| clip.begins_apart());
        let start = clip.recorded.filter(|_| skips).map_or(0.0, |r| r.interval);
        FrameTimes::between(start, clip.duration, self.fps.unwrap_or(recorded))
    }

    /// Which of `all` frames are wanted; `None` when there are none of them.
    pub fn range(&self, all: usize) -> Option<Range<usize>> {
        let end = self.first.saturating_add(self.count.unwrap_or(all)).min(all);
        (self.first < end).then_some(self.first..end)
    }
}
