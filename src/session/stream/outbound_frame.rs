//! A frame on its way out: what is known of it before its numbers are packed.

use crate::engine::Shading;
use crate::session::history::loaded_deformer::CommitSolution;
use crate::wire::frames::FrameRequest;
use crate::wire::{DeformOptions, pb, quality_message};
use glam::{DVec3, Vec3};
use std::sync::Arc;
use std::time::Duration;

/// A frame that is not packed yet.
#[derive(Debug, Clone)]
pub(in crate::session) struct OutboundFrame {
    /// Everything but the numbers.
    pub header: pb::Frame,
    pub positions: Arc<Vec<DVec3>>,
    pub shading: Option<Arc<Shading>>,
    pub output: pb::Output,
    pub diagonal: f64,
}

impl OutboundFrame {
    /// What packs the frame. `baselines` are the buffers that the reader may hold, for frames that carry changes only.
    pub fn into_request(self, baselines: Vec<Arc<Vec<Vec3>>>, part_bytes: usize) -> FrameRequest {
        FrameRequest {
            header: self.header,
            positions: self.positions,
            shading: self.shading,
            output: self.output,
            baselines,
            diagonal: self.diagonal,
            part_bytes,
        }
    }
}

/// What all frames of one piece of work have in common.
#[derive(Debug, Clone)]
pub(in crate::session) struct FrameContext {
    pub revision: u64,
    pub diagonal: f64,
    /// How long the work waited for a compute slot.
    pub queued: Duration,
}

impl FrameContext {
    /// A frame that tells `positions` and how good they are.
    pub fn build_frame(
        &self,
        seq: u64,
        settings: &DeformOptions,
        (residual, max_error): (f64, f64),
        positions: Arc<Vec<DVec3>>,
        shading: Option<Arc<Shading>>,
        solve_time: Duration,
    ) -> OutboundFrame {
        let header = pb::Frame {
            seq,
            revision: self.revision,
            residual,
            max_error,
            solve_ms: solve_time.as_secs_f64() * 1e3,
            queue_ms: self.queued.as_secs_f64() * 1e3,
            ..Default::default()
        };
        OutboundFrame {
            header,
            positions,
            shading,
            output: settings.output,
            diagonal: self.diagonal,
        }
    }

    /// The frame that ends the work on a pose.
    pub fn final_frame(&self, seq: u64, settings: &DeformOptions, solution: &CommitSolution) -> OutboundFrame {
        let errors = (solution.solved.residual, solution.solved.max_error);
        let (positions, shading) = (Arc::clone(&solution.solved.positions), solution.shading.clone());
        let mut frame = self.build_frame(seq, settings, errors, positions, shading, solution.solve_time);
        frame.header.r#final = true;
        frame.header.quality = solution.quality.as_ref().map(quality_message);
        frame
    }
}

/// Something for the transport.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "one at a time, moved straight on into a response of the same size"
)]
pub(in crate::session) enum OutboundItem {
    Message(pb::deform_response::Message),
    Frame(Box<OutboundFrame>),
    End,
}
