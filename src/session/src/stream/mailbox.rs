//! What lies between the two ends of a deform stream and the task of its session: the poses that wait, how they are merged, and
//! the frames that go out.
//!
//! Everything here is bounded. Waiting poses are merged when they become many, commits and errors have their number,
//! and a pose is taken only while a frame may be sent, so a reader that stops costs no more than the window of
//! frames. One short lock guards the state; it is never held while anything waits or computes.

use crate::answers::StreamAnswer;
use crate::capacity::memory_ledger::MemoryReservation;
use crate::config::SessionConfig;
use crate::error::{Error, ErrorCode};
use crate::metrics::Metrics;
use crate::stream::frame_window::FrameWindow;
use crate::stream::waiting_poses::{
    DraggedPoses, PoseEntries, WAITING_PARTS, WaitingPose, drop_replaced, merge_waiting_drags, stays_apart,
    target_bytes,
};
use pliant_exec::progress::CancelFlag;
use pliant_wire::frames::Frame;
use pliant_wire::{DeformOptions, Error as WireError, StreamRequest};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use tokio::sync::Notify;
use tracing::Span;

/// Errors and notices that wait unread; more end the stream.
const WAITING_NOTES: usize = 64;
/// Pongs that wait unread; more replace the oldest.
const WAITING_PONGS: usize = 16;

/// One deform stream as its session sees it.
#[derive(Debug)]
pub(crate) struct Mailbox {
    session: String,
    /// Who opened it, for the audit trail.
    pub who: Arc<str>,
    state: Mutex<StreamState>,
    /// Wakes the reader.
    reader: Notify,
    /// Wakes the session's task.
    task: Arc<Notify>,
    /// Stops the solve of this stream.
    pub cancel: Arc<CancelFlag>,
    /// The span of the stream's call.
    pub span: Span,
    metrics: Arc<Metrics>,
    max_commits: usize,
    max_entries: usize,
    /// Of targets that wait or are dragged.
    held: MemoryReservation,
}

impl Mailbox {
    /// On a session, opened by `who`; `held` is for the bytes of targets.
    pub fn new(
        session: &str,
        who: &Arc<str>,
        config: &SessionConfig,
        metrics: Arc<Metrics>,
        task: Arc<Notify>,
        held: MemoryReservation,
    ) -> Self {
        let settings = DeformOptions::with_defaults(config.window);
        Self {
            session: session.to_owned(),
            who: Arc::clone(who),
            state: Mutex::new(StreamState::new(Arc::new(settings))),
            reader: Notify::new(),
            task,
            cancel: Arc::default(),
            span: Span::current(),
            metrics,
            max_commits: config.stream_commits,
            max_entries: config.handles,
            held,
        }
    }

    fn lock_state(&self) -> MutexGuard<'_, StreamState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    // The client's side.

    /// Takes a request. The stream reports its errors.
    ///
    /// # Errors
    /// When the stream has ended.
    pub fn push(&self, request: StreamRequest) -> Result<(), Error> {
        let mut state = self.lock_state();
        if state.ended.is_some() || state.frames.finished {
            return Err(Error::new(ErrorCode::Cancelled, "the stream has ended"));
        }
        match request {
            StreamRequest::Ping(nonce) => {
                if state.pongs.len() >= WAITING_PONGS {
                    state.pongs.pop_front();
                }
                state.pongs.push_back(nonce);
                self.reader.notify_one();
            }
            StreamRequest::Ack(acknowledged) => {
                state.frames.acknowledge(acknowledged);
                state.promote_held_frame();
                self.reader.notify_one();
                self.task.notify_one();
            }
            StreamRequest::Options(Ok(settings)) => {
                state.take_options(settings);
                self.reader.notify_one();
                self.task.notify_one();
            }
            StreamRequest::Options(Err(error)) => self.end_with_error(&mut state, error.into()),
            StreamRequest::Pose {
                seq,
                commit,
                more,
                key,
                entries,
            } => {
                self.metrics.poses_received.inc();
                let settings = Arc::clone(&state.settings);
                let pose = self
                    .check_pose(&mut state, seq, commit, entries)
                    .map(|entries| WaitingPose {
                        seq,
                        entries,
                        commit,
                        more,
                        key,
                        settings,
                        poses: 1,
                    });
                match pose.and_then(|pose| self.add_pose(&mut state, pose)) {
                    Ok(()) => self.task.notify_one(),
                    Err(error) => self.refuse_pose(&mut state, seq, error),
                }
            }
        }
        Ok(())
    }

    /// Has a pose wait, if there is room for its targets.
    fn add_pose(&self, state: &mut StreamState, pose: WaitingPose) -> Result<(), Error> {
        drop_replaced(&mut state.waiting, &pose);
        if stays_apart(&pose) {
            if state.waiting.iter().filter(|w| stays_apart(w)).count() >= WAITING_PARTS {
                let text = format!("{WAITING_PARTS} parts of poses wait on this stream already; wait for a frame");
                return Err(Error::exhausted(text, 1));
            }
            state.waiting.push_back(pose);
            let bytes = target_bytes(&state.waiting, &state.dragged);
            if let Err(shortage) = self.held.grow_to(bytes) {
                state.waiting.pop_back();
                let text = format!("the targets that wait would need {bytes} bytes of memory, and {shortage}");
                return Err(Error::exhausted(text, 1));
            }
            return Ok(());
        }
        state.waiting.push_back(pose);
        merge_waiting_drags(&mut state.waiting, self.max_entries);
        Ok(())
    }

    /// The entries of a pose that may wait.
    fn check_pose(
        &self,
        state: &mut StreamState,
        seq: u64,
        commit: bool,
        entries: Result<PoseEntries, WireError>,
    ) -> Result<PoseEntries, Error> {
        if let Some(last) = state.last_seq.filter(|&last| seq <= last) {
            let text = format!("is {seq}, above {last} is allowed: numbers grow along a stream");
            return Err(Error::invalid("pose.seq", text));
        }
        state.last_seq = Some(seq);
        let entries = entries?;
        if commit && state.waiting.iter().filter(|w| w.commit).count() >= self.max_commits {
            let most = self.max_commits;
            let text = format!("{most} commits wait on this stream already; wait for their frames");
            return Err(Error::exhausted(text, 1));
        }
        Ok(entries)
    }

    fn refuse_pose(&self, state: &mut StreamState, seq: u64, error: Error) {
        self.metrics.poses_refused.inc();
        if state.notes.len() >= WAITING_NOTES {
            let text = format!("{WAITING_NOTES} errors wait unread; read them before sending more");
            return self.end_with_error(state, Error::exhausted(text, 1));
        }
        state.notes.push_back(StreamAnswer::Failure { error, seq });
        self.reader.notify_one();
    }

    /// Ends the stream with an error.
    fn end_with_error(&self, state: &mut StreamState, error: Error) {
        state.end(Some(error));
        self.cancel.cancel();
        self.reader.notify_one();
        self.task.notify_one();
    }

    /// No more requests will come; what waits is still answered.
    pub fn finish(&self) {
        let mut state = self.lock_state();
        state.frames.finish();
        state.promote_held_frame();
        self.reader.notify_one();
        self.task.notify_one();
    }

    /// What the transport may send next, `None` at the end; pending when there is nothing at the moment.
    pub fn next_answer(&self) -> Poll<Option<StreamAnswer>> {
        let mut state = self.lock_state();
        if let Some(pong) = state.pongs.pop_front() {
            return Poll::Ready(Some(StreamAnswer::Pong(pong)));
        }
        if let Some(note) = state.notes.pop_front() {
            return Poll::Ready(Some(note));
        }
        if let Some(end) = &mut state.ended {
            return Poll::Ready(end.take().map(|error| StreamAnswer::Failure { error, seq: 0 }));
        }
        if let Some(frame) = state.frames.take() {
            if state.frames.finished {
                // No acknowledgement will come, so there is room for another now.
                state.promote_held_frame();
                self.task.notify_one();
            }
            return Poll::Ready(Some(StreamAnswer::Frame(Box::new(frame))));
        }
        match state.frames.finished && state.is_idle() {
            true => Poll::Ready(None),
            false => Poll::Pending,
        }
    }

    /// Waits until `next_answer` may have something new.
    ///
    /// # Cancel safety
    /// Dropping the future loses no wake-up.
    pub async fn wait_for_change(&self) {
        self.reader.notified().await;
    }

    /// The newest frame that the client has acknowledged.
    pub fn acknowledged(&self) -> Option<u64> {
        self.lock_state().frames.acknowledged
    }

    /// The reader has left: stops the solve and drops everything.
    pub fn abandon(&self) {
        let mut state = self.lock_state();
        state.end(None);
        state.notes.clear();
        state.pongs.clear();
        self.cancel.cancel();
        self.task.notify_one();
    }

    // The session's side.

    /// The next work, when there is some and its frame may be sent: all poses up to the first commit, or all that wait, in the
    /// order in which they came; never empty. `complete_work` must follow.
    pub fn take_work(&self) -> Option<Vec<WaitingPose>> {
        let mut state = self.lock_state();
        let count = state.work_at_hand();
        if count == 0 {
            return None;
        }
        state.running = true;
        Some(state.waiting.drain(..count).collect())
    }

    /// What the stream dragged since the last commit.
    pub fn dragged_poses(&self) -> DraggedPoses {
        self.lock_state().dragged.clone()
    }

    /// Whether a newer pose waits.
    pub fn has_newer_pose(&self) -> bool {
        self.lock_state().waiting.iter().any(|w| !w.more)
    }

    /// Whether an intermediate frame may be sent. The last place in the window is kept for the final frame.
    pub fn wants_intermediate_frame(&self) -> bool {
        let state = self.lock_state();
        let (room, window) = (state.frames.room(), state.frames.size);
        state.ended.is_none() && (room >= 2 || (window == 1 && room == 1))
    }

    /// Records the poses that are not solved: refused, or skipped because a newer one came.
    pub fn settle_unsolved(&self, refused: Vec<(u64, Error)>, superseded: u32) {
        let mut state = self.lock_state();
        state.superseded = state.superseded.saturating_add(superseded);
        self.metrics.poses_superseded.inc_by(superseded.into());
        for (seq, error) in refused {
            self.refuse_pose(&mut state, seq, error);
        }
    }

    /// Sends an intermediate frame.
    pub fn send_frame(&self, mut frame: Frame) {
        let mut state = self.lock_state();
        if state.ended.is_none() {
            frame.header.superseded = std::mem::take(&mut state.superseded);
            state.frames.waiting.push_back(frame);
            self.reader.notify_one();
        }
    }

    /// Ends the work that `take_work` gave: what the stream has dragged now, and the last frame of the pose that was
    /// solved.
    pub fn complete_work(&self, dragged: DraggedPoses, frame: Option<Frame>) {
        let mut state = self.lock_state();
        state.running = false;
        state.dragged = dragged;
        // They are few beside those of the session; what is short shows at the next pose.
        let _ = self.held.resize(target_bytes(&state.waiting, &state.dragged));
        if state.ended.is_none()
            && let Some(mut frame) = frame
        {
            frame.header.superseded = std::mem::take(&mut state.superseded);
            state.hold_frame(frame);
        }
        self.reader.notify_one();
    }

    /// The handles or the commit in force changed under the stream: what it dragged is void.
    pub fn forget_dragged_poses(&self) {
        self.lock_state().dragged.clear();
    }

    /// The server stops: sends the client a notice with the session to continue elsewhere, and stores the commits that
    /// wait, whether or not their frames are read.
    pub fn leave(&self, message: &'static str) {
        let mut state = self.lock_state();
        state.leaving = true;
        let held = state.held.take();
        state.frames.waiting.extend(held);
        if state.ended.is_none() && state.notes.len() < WAITING_NOTES {
            state.notes.push_back(StreamAnswer::Notice {
                code: "going-away",
                message,
                session: self.session.clone(),
            });
        }
        self.reader.notify_one();
        self.task.notify_one();
    }

    /// Ends the stream from the server's side.
    pub fn close(&self, error: Error) {
        self.end_with_error(&mut self.lock_state(), error);
    }
}

/// The state of one stream: poses that wait, frames that go out, and what the client has acknowledged. Every pose received
/// ends as a final frame, as an error, or in the `superseded` of a frame.
#[derive(Debug)]
pub(crate) struct StreamState {
    pub settings: Arc<DeformOptions>,
    /// How many options the client has sent.
    asked: u64,
    pub waiting: VecDeque<WaitingPose>,
    pub last_seq: Option<u64>,
    pub dragged: DraggedPoses,
    pub running: bool,
    /// Poses skipped since the last frame was made.
    pub superseded: u32,
    /// Frames made and not acknowledged.
    pub frames: FrameWindow,
    /// A final frame that waits for the window.
    pub held: Option<Frame>,
    pub notes: VecDeque<StreamAnswer>,
    pub pongs: VecDeque<u64>,
    /// The server stops: commits that wait are stored now, also behind frames that are not read.
    pub leaving: bool,
    /// Nothing more is computed; an error to send, then the end.
    pub ended: Option<Option<Error>>,
}

impl StreamState {
    /// The state of a stream that has just been opened.
    pub fn new(settings: Arc<DeformOptions>) -> Self {
        Self {
            frames: FrameWindow::with_size(settings.window),
            settings,
            asked: 0,
            waiting: VecDeque::new(),
            last_seq: None,
            dragged: DraggedPoses::new(),
            running: false,
            superseded: 0,
            held: None,
            notes: VecDeque::new(),
            pongs: VecDeque::new(),
            leaving: false,
            ended: None,
        }
    }

    /// Puts options in force for the poses that follow. Their frames have no differences from those before, even if
    /// both are the same: a client that lost a frame sends its options again.
    pub fn take_options(&mut self, mut settings: DeformOptions) {
        self.asked += 1;
        settings.output.asked = self.asked;
        self.frames.size = settings.window as usize;
        self.settings = Arc::new(settings);
        self.promote_held_frame();
    }

    /// Moves the frame that waits into the window, if that has room.
    pub fn promote_held_frame(&mut self) {
        if self.frames.room() > 0
            && let Some(frame) = self.held.take()
        {
            self.frames.waiting.push_back(frame);
        }
    }

    /// Puts the last frame of a piece of work where the transport finds it, or to the side until the window has room. Of a stream
    /// that is leaving nothing is put aside: the commits that made these frames had their number.
    pub fn hold_frame(&mut self, frame: Frame) {
        if self.leaving {
            self.frames.waiting.push_back(frame);
        } else {
            self.held = Some(frame);
            self.promote_held_frame();
        }
    }

    /// How many of the waiting poses the session may have: all up to the first commit, or all that wait, when their frame has a
    /// place; while the server is going, a commit does not wait for one.
    pub fn work_at_hand(&self) -> usize {
        let to_commit = self.waiting.iter().position(|w| w.commit).map(|at| at + 1);
        let is_blocked = self.held.is_some() || self.frames.room() == 0;
        match to_commit {
            _ if self.running || self.ended.is_some() => 0,
            Some(upto) if self.leaving || !is_blocked => upto,
            // Parts wait for the pose that they are of.
            None if !is_blocked => self.waiting.iter().rposition(|w| !w.more).map_or(0, |at| at + 1),
            _ => 0,
        }
    }

    pub fn is_idle(&self) -> bool {
        !self.running && self.waiting.iter().all(|w| w.more) && self.held.is_none()
    }

    pub fn end(&mut self, error: Option<Error>) {
        if self.ended.is_none() {
            self.ended = Some(error);
            self.waiting.clear();
            self.frames.waiting.clear();
            self.held = None;
        }
    }
}

#[cfg(test)]
#[path = "mailbox_tests.rs"]
mod tests;
