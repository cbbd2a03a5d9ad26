//! What lies between the two ends of a deform stream and the task of its session: poses waiting, frames going out.
//!
//! Everything here is bounded. Waiting poses are merged when they become many, commits and errors have their number,
//! and a pose is taken only while a frame may be sent, so a reader that stops costs no more than the window of
//! frames. One short lock guards the state; it is never held while anything waits or computes.

use crate::progress::CancelFlag;
use crate::session::answers::StreamAnswer;
use crate::session::config::SessionConfig;
use crate::session::error::{Error, ErrorCode};
use crate::session::metrics::Metrics;
use crate::session::stream::stream_state::StreamState;
use crate::session::stream::waiting_poses::{DraggedPoses, PoseEntries, WaitingPose, merge_waiting_drags};
use crate::wire::frames::Frame;
use crate::wire::{DeformOptions, Error as WireError, StreamRequest};
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
pub(in crate::session) struct Mailbox {
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
}

impl Mailbox {
    /// On a session, opened by `who`.
    pub fn new(
        (session, who): (&str, &Arc<str>),
        config: &SessionConfig,
        metrics: Arc<Metrics>,
        task: Arc<Notify>,
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
                        key,
                        settings,
                        poses: 1,
                    });
                match pose {
                    Ok(pose) => {
                        state.waiting.push_back(pose);
                        merge_waiting_drags(&mut state.waiting, self.max_entries);
                        self.task.notify_one();
                    }
                    Err(error) => self.refuse_pose(&mut state, seq, error),
                }
            }
        }
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
        !self.lock_state().waiting.is_empty()
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

#[cfg(test)]
#[path = "mailbox_tests.rs"]
mod tests;
