//! The state of a stream between its client and its session.

use crate::session::answers::StreamAnswer;
use crate::session::error::Error;
use crate::session::stream::frame_window::FrameWindow;
use crate::session::stream::waiting_poses::{DraggedPoses, WaitingPose};
use crate::wire::DeformOptions;
use crate::wire::frames::Frame;
use std::collections::VecDeque;
use std::sync::Arc;

/// The state of one stream: poses that wait, frames that go out, and what the client has acknowledged. Every pose received
/// ends as a final frame, as an error, or in the `superseded` of a frame.
#[derive(Debug)]
pub(in crate::session) struct StreamState {
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
            None if !is_blocked => self.waiting.len(),
            _ => 0,
        }
    }

    pub fn is_idle(&self) -> bool {
        !self.running && self.waiting.is_empty() && self.held.is_none()
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
