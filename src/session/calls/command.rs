//! What a session's task is asked to do: calls in a queue, each with its caller.

use crate::asset::Format;
use crate::progress::CancelFlag;
use crate::session::animation::frame_outbox::FrameOutbox;
use crate::session::animation::prepared_animation::PreparedAnimation;
use crate::session::answers::{CarriedAlong, CommittedPose, ExportedModel};
use crate::session::calls::handle_change::HandleChange;
use crate::session::calls::idempotency::{KeyClaim, RequestFingerprint, answer_of_another_call};
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::WorkKind;
use crate::session::error::Error;
use crate::wire::record::AnsweredFrame;
use crate::wire::{AnimateOrder, CarryOrder, PoseCommit, SessionEdit, pb};
use prost::Message as _;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use tracing::Span;

/// A call that a session's task serves.
pub(in crate::session) trait TaskCall: Sized {
    /// What it answers with.
    type Answer;

    /// Puts it among the calls of other kinds.
    fn queued(call: QueuedCall<Self>) -> SessionCommand;

    /// The answer as it is kept for the key of a call that has one.
    fn stored(_answer: &Self::Answer) -> Option<StoredAnswer> {
        None
    }
}

/// A call that may have an idempotency key: sent twice, it is done once.
pub(in crate::session) trait KeyedCall:
    TaskCall<Answer: TryFrom<StoredAnswer, Error = Error>>
{
    /// Its name among the operations that keys stand for.
    fn operation(&self) -> &'static str;

    /// The hash of the request on session `id`.
    fn fingerprint(&self, id: &str, request: &[u8]) -> RequestFingerprint {
        RequestFingerprint::of(self.operation(), &[id.as_bytes(), request])
    }
}

/// Where a call comes from.
#[derive(Debug)]
pub(in crate::session) struct CallOrigin {
    /// Who calls, for the audit trail.
    pub who: Arc<str>,
    /// Raised when the caller has left.
    pub cancel: Arc<CancelFlag>,
    /// When it was asked for: waiting counts against the time it may take.
    pub arrived: Instant,
    pub claim: Option<KeyClaim<StoredAnswer>>,
    /// Of the call.
    pub span: Span,
}

/// A call that waits for a session's task, and where its answer goes.
#[derive(Debug)]
pub(in crate::session) struct QueuedCall<C: TaskCall> {
    pub call: C,
    pub origin: CallOrigin,
    pub reply: oneshot::Sender<Result<C::Answer, Error>>,
}

/// Gives each kind of call its answer and its place in the queue. Answers of calls that commit are kept for their keys.
macro_rules! session_calls {
    ($($kind:ident: $call:ty => $answer:ty $(, kept by $stored:expr)?;)*) => {
        /// A call of any kind in the queue of a session's task.
        pub(in crate::session) enum SessionCommand {
            $($kind(Box<QueuedCall<$call>>),)*
        }

        $(impl TaskCall for $call {
            type Answer = $answer;

            fn queued(call: QueuedCall<Self>) -> SessionCommand {
                SessionCommand::$kind(Box::new(call))
            }

            $(fn stored(answer: &Self::Answer) -> Option<StoredAnswer> {
                Some($stored(Box::new(answer.clone())))
            })?
        })*
    };
}

session_calls! {
    Handles: HandleChange => pb::Session, kept by StoredAnswer::Session;
    Solve: PoseCommit => CommittedPose, kept by StoredAnswer::Solved;
    Step: HistoryDirection => pb::Session, kept by StoredAnswer::Session;
    Edit: SessionEdit => pb::EditResult, kept by StoredAnswer::Edited;
    Recall: RecallPose => Option<CommittedPose>;
    Export: ExportModel => ExportedModel;
    Carry: CarryOrder => CarriedAlong;
    Animate: PrepareAnimation => PreparedAnimation;
}

impl KeyedCall for HandleChange {
    fn operation(&self) -> &'static str {
        match self {
            Self::Replace(_) => "set_handles",
            Self::Put(_) => "put_handle",
            Self::Remove(_) => "remove_handle",
        }
    }
}

impl KeyedCall for PoseCommit {
    fn operation(&self) -> &'static str {
        "solve"
    }
}

impl KeyedCall for SessionEdit {
    fn operation(&self) -> &'static str {
        "edit"
    }
}

impl KeyedCall for HistoryDirection {
    fn operation(&self) -> &'static str {
        match self {
            Self::Undo => "undo",
            Self::Redo => "redo",
        }
    }

    fn fingerprint(&self, id: &str, _request: &[u8]) -> RequestFingerprint {
        RequestFingerprint::of(self.operation(), &[id.as_bytes()])
    }
}

/// The answer of a pose that was committed with this revision; `None` when the history has lost it.
pub(in crate::session) struct RecallPose {
    pub revision: u64,
    pub frame: Box<AnsweredFrame>,
}

/// The model in its current shape, in a format or the one that it came in.
pub(in crate::session) struct ExportModel(pub Option<Format>);

/// Prepares an animation and reports stages to its reader.
pub(in crate::session) struct PrepareAnimation {
    pub order: AnimateOrder,
    pub outbox: Arc<FrameOutbox>,
}

/// Along the commits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::session) enum HistoryDirection {
    Undo,
    Redo,
}

impl CallOrigin {
    /// The work of a call, which may take as long as `limit` from its arrival on.
    pub fn order(&self, kind: WorkKind, lane: WorkLane, limit: Duration) -> WorkOrder {
        WorkOrder {
            kind,
            call: self.span.clone(),
            lane,
            flag: Arc::clone(&self.cancel),
            arrived: self.arrived,
            limit,
        }
    }
}

/// A piece of work for a session's engine.
#[derive(Debug)]
pub(in crate::session) struct WorkOrder {
    /// What operators call it.
    pub kind: WorkKind,
    /// The span of the call.
    pub call: Span,
    pub lane: WorkLane,
    /// Stops it.
    pub flag: Arc<CancelFlag>,
    pub arrived: Instant,
    /// How long after its arrival it may go on.
    pub limit: Duration,
}

/// An answer kept by idempotency key.
#[derive(Debug, Clone)]
pub(in crate::session) enum StoredAnswer {
    Session(Box<pb::Session>),
    Edited(Box<pb::EditResult>),
    Solved(Box<CommittedPose>),
    /// The answer follows from a commit of a stored session.
    Recorded {
        session: String,
        sequence: u64,
    },
}

/// Reads an answer of one kind from one that was kept.
macro_rules! stored_answers {
    ($($variant:ident: $answer:ty),*) => {$(
        impl TryFrom<StoredAnswer> for $answer {
            type Error = Error;

            fn try_from(stored: StoredAnswer) -> Result<Self, Error> {
                match stored {
                    StoredAnswer::$variant(answer) => Ok(*answer),
                    _ => Err(answer_of_another_call()),
                }
            }
        }
    )*};
}

stored_answers!(Session: pb::Session, Edited: pb::EditResult, Solved: CommittedPose);

impl StoredAnswer {
    /// Bytes held, about.
    pub fn byte_size(&self) -> u64 {
        let bytes = match self {
            Self::Session(session) => size_of::<pb::Session>() + session.encoded_len(),
            Self::Edited(edited) => size_of::<pb::EditResult>() + edited.encoded_len(),
            Self::Solved(solved) => return solved.frame.byte_size(),
            Self::Recorded { session, .. } => size_of::<Self>() + session.len(),
        };
        bytes as u64
    }
}
