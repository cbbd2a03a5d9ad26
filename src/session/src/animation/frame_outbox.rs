//! What lies between the task of an animation and its reader: frames going out, acknowledgements coming in.
//!
//! No frame is left out, so the task waits while the window is full: what a slow reader costs is the window of frames. One short
//! lock guards the state; it is never held while anything waits or computes.
//!
//! What was prepared for an animation.

use crate::answers::AnimationAnswer;
use crate::capacity::call_queue::CallGuard;
use crate::capacity::memory_ledger::MemoryReservation;
use crate::error::{Error, ErrorCode};
use crate::metrics::Metrics;
use crate::stream::frame_window::{FramePacker, FrameWindow};
use glam::DVec3;
use pliant_core::engine::{Animation, Shader};
use pliant_exec::progress::{CancelFlag, Progress};
use pliant_wire::AnimationSummary;
use pliant_wire::frames::Frame;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use tokio::sync::Notify;

#[derive(Default)]
struct OutboxState {
    /// The newest stage that the reader has not seen.
    stage: Option<(&'static str, f32)>,
    /// Frames made and not acknowledged.
    frames: FrameWindow,
    /// No frame follows those that wait.
    ended: bool,
    /// What is sent after them: the summary of all frames, or why there are no more.
    last: Option<Result<Box<AnimationSummary>, Error>>,
    prepared: Option<Arc<PreparedAnimation>>,
}

/// One animation between its task and its reader.
pub(crate) struct FrameOutbox {
    state: Mutex<OutboxState>,
    /// Wakes the reader.
    reader: Notify,
    /// Wakes the task.
    solver: Notify,
    /// Stops the solve under way.
    pub cancel: Arc<CancelFlag>,
}

impl std::fmt::Debug for FrameOutbox {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "FrameOutbox(window {})", self.lock_state().frames.size)
    }
}

impl FrameOutbox {
    pub fn with_window(window: u32) -> Self {
        Self {
            state: Mutex::new(OutboxState {
                frames: FrameWindow::with_size(window),
                ..OutboxState::default()
            }),
            reader: Notify::new(),
            solver: Notify::new(),
            cancel: Arc::default(),
        }
    }

    fn lock_state(&self) -> MutexGuard<'_, OutboxState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    // The reader's side.

    /// The reader has the frames up to this one.
    pub fn acknowledge(&self, seq: u64) {
        self.lock_state().frames.acknowledge(seq);
        self.solver.notify_one();
    }

    /// No acknowledgement will come any more: as many frames as the window has may wait to be taken.
    pub fn finish_input(&self) {
        self.lock_state().frames.finish();
        self.solver.notify_one();
    }

    /// The newest frame that the reader has acknowledged.
    pub fn acknowledged(&self) -> Option<u64> {
        self.lock_state().frames.acknowledged
    }

    /// What the transport may send next, `None` at the end; pending when there is nothing at the moment.
    pub fn next_answer(&self) -> Poll<Option<Result<AnimationAnswer, Error>>> {
        let mut state = self.lock_state();
        if let Some((stage, fraction)) = state.stage.take() {
            return Poll::Ready(Some(Ok(AnimationAnswer::Stage { stage, fraction })));
        }
        if let Some(frame) = state.frames.take() {
            self.solver.notify_one();
            return Poll::Ready(Some(Ok(AnimationAnswer::Frame(Box::new(frame)))));
        }
        match state.ended {
            true => Poll::Ready(state.last.take().map(|last| last.map(AnimationAnswer::Summary))),
            false => Poll::Pending,
        }
    }

    /// Waits until `next_answer` may have something new.
    ///
    /// # Cancel safety
    /// Dropping the future loses no wake-up.
    pub async fn wait_for_item(&self) {
        self.reader.notified().await;
    }

    // The task's side.

    /// Reports what is under way; only the newest stage waits for the reader.
    pub fn report_stage(&self, stage: &'static str, fraction: f32) {
        self.lock_state().stage = Some((stage, fraction));
        self.reader.notify_one();
    }

    /// The animation is prepared.
    pub fn set_prepared(&self, prepared: Arc<PreparedAnimation>) {
        self.lock_state().prepared = Some(prepared);
    }

    /// The animation, once it is prepared.
    pub fn prepared(&self) -> Option<Arc<PreparedAnimation>> {
        self.lock_state().prepared.clone()
    }

    /// Waits until there is room for a frame; false when none is wanted any more.
    pub async fn wait_for_room(&self) -> bool {
        loop {
            {
                let state = self.lock_state();
                if state.ended {
                    return false;
                }
                if state.frames.room() > 0 {
                    return true;
                }
            }
            self.solver.notified().await;
        }
    }

    /// Waits until no frame is wanted any more.
    pub async fn wait_for_end(&self) {
        while !self.lock_state().ended {
            self.solver.notified().await;
        }
    }

    /// Sends a frame.
    pub fn send_frame(&self, frame: Frame) {
        let mut state = self.lock_state();
        if !state.ended {
            state.frames.waiting.push_back(frame);
            self.reader.notify_one();
        }
    }

    /// All frames have been sent.
    pub fn complete(&self, summary: AnimationSummary) {
        let mut state = self.lock_state();
        if !state.ended {
            state.ended = true;
            state.last = Some(Ok(Box::new(summary)));
        }
        self.reader.notify_one();
    }

    /// Ends the animation before its last frame and drops frames that wait. Without an error the reader has left.
    pub fn end_early(&self, error: Option<Error>) {
        let mut state = self.lock_state();
        if !state.ended {
            state.ended = true;
            state.stage = None;
            state.frames.waiting.clear();
            state.last = error.map(Err);
        }
        self.cancel.cancel();
        self.reader.notify_one();
        self.solver.notify_one();
    }
}

/// Reports the stage of a piece of work to the reader of an animation.
pub(crate) struct StageReporter<'a> {
    pub outbox: &'a FrameOutbox,
    pub watch: &'a dyn Progress,
}

impl Progress for StageReporter<'_> {
    fn cancelled(&self) -> bool {
        self.watch.cancelled() || self.outbox.cancel.cancelled()
    }

    fn may_hold(&self, bytes: u64) -> bool {
        self.watch.may_hold(bytes)
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        self.watch.report(stage, fraction);
        self.outbox.report_stage(stage, fraction);
    }
}

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
pub(crate) fn animation_ends(
    outbox: &Arc<FrameOutbox>,
    metrics: &Arc<Metrics>,
    held: MemoryReservation,
    inside: CallGuard,
) -> (AnimationControl, AnimationReader) {
    let input = AnimationControl {
        outbox: Arc::clone(outbox),
    };
    let output = AnimationReader {
        outbox: Arc::clone(outbox),
        packer: FramePacker::default(),
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
            match self.outbox.next_answer() {
                Poll::Ready(Some(Ok(AnimationAnswer::Frame(frame)))) => {
                    self.metrics.frames_sent.inc();
                    let packed = self.packer.pack_frame(*frame, self.outbox.acknowledged());
                    return Some(Ok(AnimationAnswer::Frame(Box::new(packed))));
                }
                Poll::Ready(answer) => return answer,
                Poll::Pending => self.outbox.wait_for_item().await,
            }
        }
    }

    /// The animation, once it is prepared.
    pub(crate) fn prepared(&self) -> Option<Arc<PreparedAnimation>> {
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

/// An animation that is ready to be solved. What becomes of the session's deformer does not affect it.
pub(crate) struct PreparedAnimation {
    pub animation: Animation,
    /// What makes normals and tangents, when they are wanted.
    pub shader: Option<Arc<Shader>>,
    /// The session's revision when it was prepared.
    pub revision: u64,
    /// What positions are relative to as they are sent.
    pub origin: DVec3,
    /// Milliseconds by stage.
    pub build_ms: BTreeMap<String, f64>,
}

impl PreparedAnimation {
    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.animation.byte_size() + self.shader.as_ref().map_or(0, |s| s.byte_size())
    }
}

impl std::fmt::Debug for PreparedAnimation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PreparedAnimation(frames {:?})", self.animation.range())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ErrorCode;
    use futures::poll;
    use pliant_wire::pb;

    fn frame(seq: u64) -> Frame {
        Frame {
            header: pb::Frame {
                seq,
                ..Default::default()
            },
            part_bytes: 1 << 20,
            ..Frame::default()
        }
    }

    fn taken(outbox: &FrameOutbox) -> Option<u64> {
        match outbox.next_answer() {
            Poll::Ready(Some(Ok(AnimationAnswer::Frame(frame)))) => Some(frame.header.seq),
            _ => None,
        }
    }

    async fn has_room(outbox: &FrameOutbox) -> bool {
        let waiting = outbox.wait_for_room();
        tokio::pin!(waiting);
        poll!(waiting).is_ready()
    }

    #[tokio::test]
    async fn the_window_holds_the_solver_until_frames_are_acknowledged() {
        let outbox = FrameOutbox::with_window(2);
        for seq in 1..=2 {
            assert!(has_room(&outbox).await);
            outbox.send_frame(frame(seq));
        }
        assert!(!has_room(&outbox).await);
        assert_eq!((taken(&outbox), taken(&outbox)), (Some(1), Some(2)));
        assert!(!has_room(&outbox).await, "taken is not acknowledged");
        outbox.acknowledge(1);
        assert!(has_room(&outbox).await);
        outbox.send_frame(frame(3));
        assert!(!has_room(&outbox).await);
        outbox.finish_input();
        assert!(has_room(&outbox).await, "no one is left to acknowledge");
    }

    #[tokio::test]
    async fn every_frame_comes_before_the_summary() {
        let outbox = FrameOutbox::with_window(8);
        outbox.report_stage("clip", 0.0);
        outbox.report_stage("fields", 0.5);
        outbox.send_frame(frame(1));
        outbox.complete(AnimationSummary::default());
        outbox.end_early(Some(Error::new(ErrorCode::NotFound, "too late")));
        assert!(matches!(
            outbox.next_answer(),
            Poll::Ready(Some(Ok(AnimationAnswer::Stage { stage: "fields", .. })))
        ));
        assert_eq!(taken(&outbox), Some(1));
        assert!(matches!(
            outbox.next_answer(),
            Poll::Ready(Some(Ok(AnimationAnswer::Summary(_))))
        ));
        assert!(matches!(outbox.next_answer(), Poll::Ready(None)));
    }

    #[tokio::test]
    async fn a_failure_is_reported_at_once_and_once() {
        let outbox = FrameOutbox::with_window(8);
        outbox.send_frame(frame(1));
        outbox.end_early(Some(Error::new(ErrorCode::NotFound, "gone")));
        outbox.send_frame(frame(2));
        assert!(outbox.cancel.cancelled());
        assert!(!outbox.wait_for_room().await);
        assert!(matches!(outbox.next_answer(), Poll::Ready(Some(Err(e))) if e.message == "gone"));
        assert!(matches!(outbox.next_answer(), Poll::Ready(None)));
    }
}
