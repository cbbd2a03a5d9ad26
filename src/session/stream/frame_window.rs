//! Frames on their way to a reader: how they begin, and how many of them may wait.

use crate::engine::{Shading, TopologyId};
use crate::wire::frames::{Frame, FrameOutput};
use crate::wire::pb;
use glam::DVec3;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// What all frames of one piece of work have in common.
#[derive(Debug, Clone)]
pub(in crate::session) struct FrameContext {
    pub revision: u64,
    /// What edits have made of the model.
    pub topology: Option<TopologyId>,
    pub diagonal: f64,
    /// How long the work waited for a compute slot.
    pub queued: Duration,
    /// Bytes that the data of a part may take.
    pub part_bytes: usize,
}

impl FrameContext {
    /// A frame of all vertices, of the pose of number `seq`; its accuracy and the time of its solve are still to be filled in.
    pub fn frame(
        &self,
        seq: u64,
        output: FrameOutput,
        positions: Arc<Vec<DVec3>>,
        shading: Option<Arc<Shading>>,
    ) -> Frame {
        Frame {
            header: pb::Frame {
                seq,
                revision: self.revision,
                queue_ms: ms_of(self.queued),
                ..Default::default()
            },
            topology: self.topology,
            diagonal: self.diagonal,
            positions,
            shading,
            output,
            part_bytes: self.part_bytes,
            ..Frame::default()
        }
    }
}

/// Milliseconds.
pub(in crate::session) fn ms_of(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Frames that a reader has not acknowledged: at most as many as its window has.
#[derive(Debug, Default)]
pub(in crate::session) struct FrameWindow {
    /// The most frames that may be made and not acknowledged.
    pub size: usize,
    /// Made and not yet taken by the transport.
    pub waiting: VecDeque<Frame>,
    /// Seq of every frame taken by the transport and not acknowledged.
    unacknowledged: VecDeque<u64>,
    /// The newest frame that the reader has acknowledged.
    pub acknowledged: Option<u64>,
    /// No acknowledgement will come any more: only frames that are not taken count.
    pub finished: bool,
}

impl FrameWindow {
    pub fn with_size(size: u32) -> Self {
        Self {
            size: size as usize,
            ..Self::default()
        }
    }

    /// How many frames may still be made.
    pub fn room(&self) -> usize {
        self.size.saturating_sub(self.waiting.len() + self.unacknowledged.len())
    }

    /// The reader has the frames up to this one.
    pub fn acknowledge(&mut self, seq: u64) {
        self.unacknowledged.retain(|&taken| taken > seq);
        self.acknowledged = self.acknowledged.max(Some(seq));
    }

    /// No acknowledgement will come any more.
    pub fn finish(&mut self) {
        self.finished = true;
        self.unacknowledged.clear();
    }

    /// Takes the next frame, for the transport.
    pub fn take(&mut self) -> Option<Frame> {
        let frame = self.waiting.pop_front()?;
        if !self.finished {
            self.unacknowledged.push_back(frame.header.seq);
        }
        Some(frame)
    }
}
