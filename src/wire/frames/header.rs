//! The header of a frame.

use super::pb;
use crate::engine::{QualityReport, TopologyId};
use crate::motion::rig::RigidMotion;
use crate::wire::facts::quality_message;
use glam::DVec3;

/// A frame without its numbers. All its parts repeat it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrameHeader {
    /// The number of the pose that it shows.
    pub seq: u64,
    /// The session's revision.
    pub revision: u64,
    /// The state of the model that its vertices belong to. It is not sent; no frame is a difference from one of another
    /// state.
    pub topology: Option<TopologyId>,
    /// Length of the model's diagonal; [`changed_only`](super::FrameOutput::changed_only) is a fraction of it. It is not
    /// sent.
    pub diagonal: f64,
    /// Whether it ends the work on its pose.
    pub is_final: bool,
    /// Relative residual reached.
    pub residual: f64,
    /// Estimated largest missing displacement, as a fraction of the diagonal.
    pub max_error: f64,
    /// Milliseconds of solving.
    pub solve_ms: f64,
    /// Milliseconds of waiting for a compute slot.
    pub queue_ms: f64,
    /// Poses that were skipped since the frame before.
    pub superseded: u32,
    /// How far the shape of a commit, or of a frame of an animation, is from the rest shape.
    pub quality: Option<QualityReport>,
    /// Which frame of an animation it is.
    pub animated: Option<Box<AnimatedHeader>>,
}

/// What a frame of an animation adds.
#[derive(Debug, Clone, PartialEq)]
pub struct AnimatedHeader {
    /// Its number.
    pub index: usize,
    /// Frames of the whole animation.
    pub count: usize,
    /// When it is, in seconds of the clip.
    pub seconds: f64,
    /// Where the root bone has moved the model, when that is not in the positions.
    pub root: RigidMotion,
    /// Digest of the positions as the root bone sees them.
    pub digest: String,
    /// Cycles of the solver.
    pub cycles: usize,
}

/// What all parts of a frame repeat.
pub(super) fn header_message(header: &FrameHeader) -> pb::Frame {
    pb::Frame {
        seq: header.seq,
        revision: header.revision,
        r#final: header.is_final,
        residual: header.residual,
        max_error: header.max_error,
        solve_ms: header.solve_ms,
        queue_ms: header.queue_ms,
        superseded: header.superseded,
        quality: header.quality.as_ref().map(quality_message),
        animated: header.animated.as_deref().map(animated_message),
        ..Default::default()
    }
}

fn animated_message(header: &AnimatedHeader) -> pb::Animated {
    let narrow = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    pb::Animated {
        index: narrow(header.index),
        count: narrow(header.count),
        time: header.seconds,
        root_translation: header.root.place(DVec3::ZERO).to_array().to_vec(),
        root_rotation: header.root.rotation.to_array().to_vec(),
        digest: header.digest.clone(),
        cycles: narrow(header.cycles),
        ..Default::default()
    }
}
