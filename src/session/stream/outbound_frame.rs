//! A frame on its way out: what is known of it before its numbers are encoded.

use crate::engine::{Shading, TopologyId};
use crate::session::answers::StreamAnswer;
use crate::session::history::loaded_deformer::CommitSolution;
use crate::wire::DeformOptions;
use crate::wire::frames::{FrameHeader, FrameOutput, FrameRequest};
use glam::DVec3;
use std::sync::Arc;
use std::time::Duration;

/// A frame before it is known what the reader holds.
#[derive(Debug, Clone)]
pub(in crate::session) struct OutboundFrame {
    pub header: FrameHeader,
    pub positions: Arc<Vec<DVec3>>,
    pub shading: Option<Arc<Shading>>,
    pub output: FrameOutput,
    pub diagonal: f64,
}

impl OutboundFrame {
    /// The frame for a reader that holds nothing.
    pub fn into_first_request(self, part_bytes: usize) -> FrameRequest {
        let changes = self.output.changed_only.is_some();
        let all = changes.then(|| (0..self.positions.len()).map(|v| v as u32).collect());
        self.into_request(all, part_bytes)
    }

    /// The frame with these vertices, ascending; `None` is all of them.
    pub fn into_request(self, selected: Option<Vec<u32>>, part_bytes: usize) -> FrameRequest {
        FrameRequest {
            header: self.header,
            positions: self.positions,
            shading: self.shading,
            output: self.output,
            selected,
            part_bytes,
        }
    }
}

/// What all frames of one piece of work have in common.
#[derive(Debug, Clone)]
pub(in crate::session) struct FrameContext {
    pub revision: u64,
    /// What edits have made of the model.
    pub topology: Option<TopologyId>,
    pub diagonal: f64,
    /// How long the work waited for a compute slot.
    pub queued: Duration,
}

/// A shape to be sent, and how good it is.
#[derive(Debug)]
pub(in crate::session) struct FrameShape {
    pub positions: Arc<Vec<DVec3>>,
    pub shading: Option<Arc<Shading>>,
    /// Relative residual reached.
    pub residual: f64,
    /// Estimated largest missing displacement.
    pub max_error: f64,
}

impl FrameContext {
    /// A frame of `shape`, `solve_time` after the solve began.
    pub fn build_frame(&self, seq: u64, output: FrameOutput, shape: FrameShape, solve_time: Duration) -> OutboundFrame {
        let header = FrameHeader {
            seq,
            revision: self.revision,
            topology: self.topology,
            residual: shape.residual,
            max_error: shape.max_error,
            solve_ms: solve_time.as_secs_f64() * 1e3,
            queue_ms: self.queued.as_secs_f64() * 1e3,
            ..FrameHeader::default()
        };
        OutboundFrame {
            header,
            positions: shape.positions,
            shading: shape.shading,
            output,
            diagonal: self.diagonal,
        }
    }

    /// The frame that ends the work on a pose.
    pub fn final_frame(&self, seq: u64, settings: &DeformOptions, solution: &CommitSolution) -> OutboundFrame {
        let shape = FrameShape {
            positions: Arc::clone(&solution.solved.positions),
            shading: solution.shading.clone(),
            residual: solution.solved.residual,
            max_error: solution.solved.max_error,
        };
        let mut frame = self.build_frame(seq, settings.output, shape, solution.solve_time);
        frame.header.is_final = true;
        frame.header.quality = solution.quality;
        frame
    }
}

/// Something for the transport.
#[derive(Debug)]
pub(in crate::session) enum OutboundItem {
    /// Words, ready to be sent.
    Words(StreamAnswer),
    Frame(Box<OutboundFrame>),
    End,
}
