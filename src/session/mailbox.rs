//! What lies between the two ends of a deform stream and the task of its session: poses waiting, frames going out.
//!
//! Everything here is bounded. Waiting poses are merged when they become many, commits and errors have their number,
//! and a pose is taken only while a frame may be sent, so a reader that stops costs no more than the window of
//! frames. One short lock guards the books; it is never held while anything waits or computes.
//!
//! The books: every pose received ends as a final frame, as an error, or in the `superseded` of a frame.

use super::outgoing::{Letter, Outgoing};
use super::waiting::{Overlay, Waiting, fits, merge};
use super::{Code, Config, Error, Metrics};
use crate::progress::CancelFlag;
use crate::wire::{DeformOptions, pb};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Errors and notices that wait unread; more end the stream.
const WAITING_NOTES: usize = 64;
/// Pongs that wait unread; more replace the oldest.
const WAITING_PONGS: usize = 16;

/// What a stream gives its session to do: all poses up to the first commit, or all that wait.
#[derive(Debug)]
pub(super) struct Work {
    /// In the order in which they came; never empty.
    pub poses: Vec<Waiting>,
    /// What the stream dragged since the last commit.
    pub overlay: Overlay,
}

/// How a piece of work ended.
#[derive(Debug, Default)]
pub(super) struct Done {
    /// What the stream has dragged now.
    pub overlay: Overlay,
    /// The frame of the pose that was solved.
    pub frame: Option<Outgoing>,
    /// Why that pose could not be solved.
    pub refused: Option<(u64, Error)>,
}

/// One deform stream as its session sees it.
#[derive(Debug)]
pub(super) struct Mailbox {
    session: String,
    books: Mutex<Books>,
    /// Wakes the reader.
    reader: Notify,
    /// Wakes the session's task.
    task: Arc<Notify>,
    /// Stops the solve of this stream.
    pub cancel: Arc<CancelFlag>,
    metrics: Arc<Metrics>,
    max_window: u32,
    max_commits: usize,
    max_entries: usize,
}

#[derive(Debug)]
struct Books {
    settings: Arc<DeformOptions>,
    waiting: VecDeque<Waiting>,
    last_seq: Option<u64>,
    overlay: Overlay,
    running: bool,
    /// Poses skipped since the last frame was made.
    superseded: u32,
    /// Frames made and not yet taken by the transport.
    frames: VecDeque<Outgoing>,
    /// A final frame that waits for the window.
    held: Option<Outgoing>,
    /// Seq of every frame taken by the transport and not acknowledged.
    unacknowledged: VecDeque<u64>,
    acknowledged: Option<u64>,
    notes: VecDeque<pb::deform_response::Message>,
    pongs: VecDeque<pb::Ping>,
    /// No more requests will come.
    finished: bool,
    /// Nothing more is computed; an error to say, then the end.
    ended: Option<Option<Error>>,
}

impl Books {
    /// Frames that may still be made: the window counts what was taken and not acknowledged, and what is not taken yet.
    /// After the last request no acknowledgement can come, so only the latter counts.
    fn room(&self) -> usize {
        let waiting_for_acks = if self.finished { 0 } else { self.unacknowledged.len() };
        (self.settings.window as usize).saturating_sub(self.frames.len() + waiting_for_acks)
    }

    fn promote(&mut self) {
        if self.room() > 0
            && let Some(frame) = self.held.take()
        {
            self.frames.push_back(frame);
        }
    }

    fn idle(&self) -> bool {
        !self.running && self.waiting.is_empty() && self.held.is_none()
    }

    fn end(&mut self, error: Option<Error>) {
        if self.ended.is_none() {
            self.ended = Some(error);
            self.waiting.clear();
            self.frames.clear();
            self.held = None;
        }
    }
}

impl Mailbox {
    pub fn new(session: &str, config: &Config, metrics: Arc<Metrics>, task: Arc<Notify>) -> Result<Self, Error> {
        let settings = DeformOptions::check(&pb::Options::default(), "options", config.window)?;
        Ok(Self {
            session: session.to_owned(),
            books: Mutex::new(Books {
                settings: Arc::new(settings),
                waiting: VecDeque::new(),
                last_seq: None,
                overlay: Overlay::new(),
                running: false,
                superseded: 0,
                frames: VecDeque::new(),
                held: None,
                unacknowledged: VecDeque::new(),
                acknowledged: None,
                notes: VecDeque::new(),
                pongs: VecDeque::new(),
                finished: false,
                ended: None,
            }),
            reader: Notify::new(),
            task,
            cancel: Arc::default(),
            metrics,
            max_window: config.window,
            max_commits: config.stream_commits,
            max_entries: config.handles,
        })
    }

    fn books(&self) -> MutexGuard<'_, Books> {
        self.books.lock().unwrap_or_else(PoisonError::into_inner)
    }

    // The client's side.

    /// Takes a request. What is wrong with it is told on the stream.
    ///
    /// # Errors
    /// When the stream has ended.
    pub fn push(&self, request: pb::DeformRequest) -> Result<(), Error> {
        let mut books = self.books();
        if books.ended.is_some() || books.finished {
            return Err(Error::new(Code::Cancelled, "the stream has ended"));
        }
        if !request.session_id.is_empty() && request.session_id != self.session {
            let text = "is not the session of this stream; a stream keeps to one session";
            self.fail(&mut books, Error::invalid("sessionId", text));
            return Ok(());
        }
        match request.message {
            None => {}
            Some(pb::deform_request::Message::Ping(ping)) => {
                if books.pongs.len() >= WAITING_PONGS {
                    books.pongs.pop_front();
                }
                books.pongs.push_back(ping);
                self.reader.notify_one();
            }
            Some(pb::deform_request::Message::Ack(ack)) => {
                books.unacknowledged.retain(|&seq| seq > ack.seq);
                books.acknowledged = books.acknowledged.max(Some(ack.seq));
                books.promote();
                self.reader.notify_one();
                self.task.notify_one();
            }
            Some(pb::deform_request::Message::Options(options)) => {
                match DeformOptions::check(&options, "options", self.max_window) {
                    Ok(settings) => {
                        books.settings = Arc::new(settings);
                        books.promote();
                        self.reader.notify_one();
                        self.task.notify_one();
                    }
                    Err(error) => self.fail(&mut books, error.into()),
                }
            }
            Some(pb::deform_request::Message::Pose(pose)) => self.push_pose(&mut books, pose),
        }
        Ok(())
    }

    fn push_pose(&self, books: &mut Books, pose: pb::Pose) {
        self.metrics.poses_received.inc();
        if let Some(last) = books.last_seq.filter(|&last| pose.seq <= last) {
            let text = format!("is {}, above {last} is allowed: numbers grow along a stream", pose.seq);
            return self.refuse(books, pose.seq, Error::invalid("pose.seq", text));
        }
        books.last_seq = Some(pose.seq);
        if let Err(error) = fits(&pose, self.max_entries) {
            return self.refuse(books, pose.seq, error);
        }
        if pose.commit && books.waiting.iter().filter(|w| w.commit).count() >= self.max_commits {
            let text = format!(
                "{} commits wait on this stream already; wait for their frames",
                self.max_commits
            );
            return self.refuse(books, pose.seq, Error::exhausted(text, 1));
        }
        let settings = Arc::clone(&books.settings);
        books.waiting.push_back(Waiting {
            seq: pose.seq,
            entries: pose.handles,
            commit: pose.commit,
            settings,
            poses: 1,
        });
        merge(&mut books.waiting, self.max_entries);
        self.task.notify_one();
    }

    fn refuse(&self, books: &mut Books, seq: u64, error: Error) {
        self.metrics.poses_refused.inc();
        if books.notes.len() >= WAITING_NOTES {
            let text = format!("{WAITING_NOTES} errors wait unread; read them before sending more");
            return self.fail(books, Error::exhausted(text, 1));
        }
        books
            .notes
            .push_back(pb::deform_response::Message::Error(told(error, seq)));
        self.reader.notify_one();
    }

    /// Ends the stream with an error.
    fn fail(&self, books: &mut Books, error: Error) {
        books.end(Some(error));
        self.cancel.cancel();
        self.reader.notify_one();
        self.task.notify_one();
    }

    /// No more requests will come; what waits is still answered.
    pub fn finish(&self) {
        let mut books = self.books();
        books.finished = true;
        books.promote();
        self.reader.notify_one();
        self.task.notify_one();
    }

    /// What the transport may send next; `None` when there is nothing at the moment.
    pub fn collect(&self) -> Option<Letter> {
        let mut books = self.books();
        if let Some(pong) = books.pongs.pop_front() {
            return Some(Letter::Message(pb::deform_response::Message::Pong(pong)));
        }
        if let Some(note) = books.notes.pop_front() {
            return Some(Letter::Message(note));
        }
        if let Some(end) = &mut books.ended {
            return Some(match end.take() {
                Some(error) => Letter::Message(pb::deform_response::Message::Error(told(error, 0))),
                None => Letter::End,
            });
        }
        if let Some(frame) = books.frames.pop_front() {
            books.unacknowledged.push_back(frame.header.seq);
            if books.finished {
                // There is room for another now, and nobody left to acknowledge.
                books.unacknowledged.clear();
                books.promote();
                self.task.notify_one();
            }
            return Some(Letter::Frame(Box::new(frame)));
        }
        (books.finished && books.idle()).then_some(Letter::End)
    }

    /// Waits until `collect` may have something new.
    ///
    /// # Cancel safety
    /// Dropping the future loses no wake-up.
    pub async fn changed(&self) {
        self.reader.notified().await;
    }

    /// The newest frame that the client has acknowledged.
    pub fn acknowledged(&self) -> Option<u64> {
        self.books().acknowledged
    }

    /// Nobody reads any more: stops the solve and forgets everything.
    pub fn abandon(&self) {
        let mut books = self.books();
        books.end(None);
        books.notes.clear();
        books.pongs.clear();
        self.cancel.cancel();
        self.task.notify_one();
    }

    // The session's side.

    /// The next work, when there is some and its frame may be sent. `complete` must follow.
    pub fn take(&self) -> Option<Work> {
        let mut books = self.books();
        if books.running
            || books.held.is_some()
            || books.ended.is_some()
            || books.waiting.is_empty()
            || books.room() == 0
        {
            return None;
        }
        let upto = books
            .waiting
            .iter()
            .position(|w| w.commit)
            .unwrap_or(books.waiting.len() - 1);
        let poses = books.waiting.drain(..=upto).collect();
        books.running = true;
        Some(Work {
            poses,
            overlay: books.overlay.clone(),
        })
    }

    /// Whether a newer pose waits.
    pub fn newer(&self) -> bool {
        !self.books().waiting.is_empty()
    }

    /// Whether an intermediate frame may be sent. The last place in the window is kept for the final frame.
    pub fn wants_more(&self) -> bool {
        let books = self.books();
        let (room, window) = (books.room(), books.settings.window as usize);
        books.ended.is_none() && (room >= 2 || (window == 1 && room == 1))
    }

    /// Tells what became of the poses that are not solved: refused, or skipped because a newer one came.
    pub fn settle(&self, refused: Vec<(u64, Error)>, superseded: u32) {
        let mut books = self.books();
        books.superseded = books.superseded.saturating_add(superseded);
        self.metrics.poses_superseded.inc_by(superseded.into());
        for (seq, error) in refused {
            self.refuse(&mut books, seq, error);
        }
    }

    /// Sends an intermediate frame.
    pub fn send(&self, mut frame: Outgoing) {
        let mut books = self.books();
        if books.ended.is_none() {
            frame.header.superseded = std::mem::take(&mut books.superseded);
            books.frames.push_back(frame);
            self.reader.notify_one();
        }
    }

    /// Ends the work that `take` gave.
    pub fn complete(&self, done: Done) {
        let mut books = self.books();
        books.running = false;
        books.overlay = done.overlay;
        if books.ended.is_none()
            && let Some(mut frame) = done.frame
        {
            frame.header.superseded = std::mem::take(&mut books.superseded);
            books.held = Some(frame);
            books.promote();
        }
        if let Some((seq, error)) = done.refused {
            self.refuse(&mut books, seq, error);
        }
        self.reader.notify_one();
    }

    /// The handles or the commit in force changed under the stream: what it dragged is void.
    pub fn forget_overlay(&self) {
        self.books().overlay.clear();
    }

    /// Tells the client something.
    pub fn notice(&self, code: &str, message: &str) {
        let mut books = self.books();
        if books.ended.is_none() && books.notes.len() < WAITING_NOTES {
            let notice = pb::Notice {
                code: code.into(),
                message: message.into(),
                resume_token: self.session.clone(),
            };
            books.notes.push_back(pb::deform_response::Message::Notice(notice));
            self.reader.notify_one();
        }
    }

    /// Ends the stream from the server's side.
    pub fn close(&self, error: Error) {
        self.fail(&mut self.books(), error);
    }
}

/// An error as a stream tells it.
fn told(error: Error, seq: u64) -> pb::Error {
    pb::Error {
        code: u32::try_from(error.grpc_code()).unwrap_or(2),
        message: error.message,
        seq,
    }
}

#[cfg(test)]
mod tests;
