//! The client's two ends of an animation.

use crate::session::animation::frame_outbox::{FrameOutbox, OutboxItem};
use crate::session::animation::running_animation::PreparedAnimation;
use crate::session::answers::AnimationAnswer;
use crate::session::capacity::call_gate::CallGuard;
use crate::session::capacity::memory_ledger::MemoryReservation;
use crate::session::error::{Error, ErrorCode};
use crate::session::metrics::Metrics;
use crate::session::stream::frame_packer::FramePacker;
use std::sync::Arc;

/// Where acknowledgements go in. Dropping it means [`AnimationControl::finish_input`].
#[derive(Debug)]
pub struct AnimationControl {
    outbox: Arc<FrameOutbox>,
}

/// Where frames come out. Dropping it stops the animation within one cycle of the solver.
#[derive(Debug)]
pub struct AnimationReader {
    outbox: Arc<FrameOutbox>,
    packer: FramePacker,
    metrics: Arc<Metrics>,
    held: MemoryReservation,
    _inside: CallGuard,
}

/// The two ends of an animation.
pub(in crate::session) fn animation_ends(
    outbox: &Arc<FrameOutbox>,
    part_bytes: usize,
    (metrics, held): (&Arc<Metrics>, MemoryReservation),
    inside: CallGuard,
) -> (AnimationControl, AnimationReader) {
    let input = AnimationControl {
        outbox: Arc::clone(outbox),
    };
    let output = AnimationReader {
        outbox: Arc::clone(outbox),
        packer: FramePacker::new(part_bytes),
        metrics: Arc::clone(metrics),
        held,
        _inside: inside,
    };
    (input, output)
}

impl AnimationControl {
    /// The client has the frames up to this number.
    pub fn acknowledge(&self, seq: u64) {
        self.outbox.acknowledge(seq);
    }

    /// The client wants no more frames; the output says so and ends.
    pub fn cancel_animation(&self) {
        let error = Error::new(ErrorCode::Cancelled, "the client has cancelled the animation");
        self.outbox.end_early(Some(error));
    }

    /// No acknowledgement will come any more; frames go out as fast as they are taken.
    pub fn finish_input(&self) {
        self.outbox.finish_input();
    }
}

impl Drop for AnimationControl {
    fn drop(&mut self) {
        self.outbox.finish_input();
    }
}

impl AnimationReader {
    /// The next answer, or `None` when the animation has ended.
    ///
    /// # Cancel safety
    /// Dropping the future loses no answer.
    ///
    /// # Errors
    /// Why the animation ends before its last frame; then it is over.
    pub async fn next_answer(&mut self) -> Option<Result<AnimationAnswer, Error>> {
        loop {
            return Some(Ok(match self.outbox.take_item() {
                None => {
                    self.outbox.wait_for_item().await;
                    continue;
                }
                Some(OutboxItem::Stage(stage, fraction)) => AnimationAnswer::Stage { stage, fraction },
                Some(OutboxItem::Frame(frame)) => {
                    self.metrics.frames_sent.inc();
                    let request = self.packer.pack_frame(*frame, self.outbox.acknowledged());
                    AnimationAnswer::Frame(Box::new(request))
                }
                Some(OutboxItem::Summary(summary)) => AnimationAnswer::Summary(summary),
                Some(OutboxItem::Failure(error)) => return Some(Err(error)),
                Some(OutboxItem::End) => return None,
            }));
        }
    }

    /// The animation, once it is prepared.
    pub(in crate::session) fn prepared(&self) -> Option<Arc<PreparedAnimation>> {
        self.outbox.prepared()
    }

    /// Says how many bytes who sends the frames holds for the differences of the next one. They are counted even where they are more
    /// than there is room for: they are little beside what the session holds, and what is sent depends on no other session.
    pub fn hold_bytes(&self, bytes: u64) {
        let _ = self.held.resize(bytes);
    }

    /// Counts the bytes of a part that goes out.
    pub fn count_part_bytes(&self, bytes: usize) {
        self.metrics.frame_bytes.inc_by(bytes as u64);
    }
}

impl Drop for AnimationReader {
    fn drop(&mut self) {
        self.outbox.end_early(None);
    }
}
