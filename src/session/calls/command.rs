//! What a session's task is asked to do: calls in a queue, each with its caller.

use crate::asset::Format;
use crate::engine::DeformerFacts;
use crate::progress::CancelFlag;
use crate::session::animation::frame_outbox::FrameOutbox;
use crate::session::answers::{CommittedEdit, CommittedPose, SessionFacts, Tenant};
use crate::session::calls::idempotency::{KeyClaim, RequestFingerprint, answer_of_another_call};
use crate::session::calls::manager::Manager;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::WorkKind;
use crate::session::error::Error;
use crate::session::task::session_task::SessionTask;
use crate::wire::AnimateOrder;
use crate::wire::record::AnsweredFrame;
use futures::FutureExt as _;
use futures::future::BoxFuture;
use std::future::Future;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use tracing::Span;

/// A call that a session's task serves.
pub(in crate::session) trait Call: Send + 'static {
    /// What it answers with.
    type Answer: Send + 'static;

    /// Serves it on the session's task.
    fn run(self, task: &mut SessionTask, caller: &Caller) -> impl Future<Output = Result<Self::Answer, Error>> + Send;

    /// The answer as it is kept for the key of a call that has one.
    fn stored(_answer: &Self::Answer) -> Option<StoredAnswer> {
        None
    }
}

/// A call that may have an idempotency key: sent twice, it is done once.
pub(in crate::session) trait KeyedCall: Call<Answer: TryFrom<StoredAnswer, Error = Error>> {
    /// Its name among the operations that keys stand for.
    fn operation(&self) -> &'static str;

    /// The hash of the request on session `id`.
    fn fingerprint(&self, id: &str, request: &[u8]) -> RequestFingerprint {
        RequestFingerprint::of(self.operation(), &[id.as_bytes(), request])
    }

    /// Done before the session's task gets the call, which is no repetition.
    fn prepare(&mut self, _manager: &Manager, _tenant: &Tenant) -> impl Future<Output = Result<(), Error>> + Send {
        async { Ok(()) }
    }
}

/// Who waits for an answer.
#[derive(Debug)]
pub(in crate::session) struct Caller {
    /// The name for the audit trail.
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
pub(in crate::session) struct QueuedCall<C: Call> {
    pub call: C,
    pub caller: Caller,
    pub reply: oneshot::Sender<Result<C::Answer, Error>>,
}

/// A [`QueuedCall`] of any kind.
pub(in crate::session) trait ServeCall: Send {
    fn caller(&self) -> &Caller;

    /// Serves the call, keeps the answer for its key and sends it to the caller.
    fn serve(self: Box<Self>, task: &mut SessionTask) -> BoxFuture<'_, ()>;
}

impl<C: Call> ServeCall for QueuedCall<C> {
    fn caller(&self) -> &Caller {
        &self.caller
    }

    fn serve(self: Box<Self>, task: &mut SessionTask) -> BoxFuture<'_, ()> {
        let Self { call, caller, reply } = *self;
        let serving = async move {
            let result = call.run(task, &caller).await;
            if let (Some(claim), Ok(answer)) = (caller.claim, &result)
                && let Some(stored) = C::stored(answer)
            {
                let bytes = stored.byte_size();
                claim.complete(stored, bytes);
            }
            // The caller may have gone; the change stands.
            let _ = reply.send(result);
        };
        serving.boxed()
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

impl Caller {
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
    Session(Box<SessionFacts>),
    Edited(Box<CommittedEdit>),
    Solved(Box<CommittedPose>),
    /// The answer follows from a commit of a stored session.
    Recorded {
        session: String,
        sequence: u64,
    },
}

/// Makes a kind of answers one that is kept.
macro_rules! stored_answers {
    ($($variant:ident: $answer:ty),*) => {$(
        impl From<&$answer> for StoredAnswer {
            fn from(answer: &$answer) -> Self {
                Self::$variant(Box::new(answer.clone()))
            }
        }

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

stored_answers!(Session: SessionFacts, Edited: CommittedEdit, Solved: CommittedPose);

impl StoredAnswer {
    /// Bytes held, about.
    pub fn byte_size(&self) -> u64 {
        let bytes = match self {
            Self::Session(session) => {
                size_of::<SessionFacts>()
                    + session.label.len()
                    + facts_bytes(&session.deformer)
                    + size_of_val(session.poses.0.as_slice())
            }
            Self::Edited(edited) => {
                let report = &edited.report;
                let names: usize = report
                    .handles_kept
                    .iter()
                    .map(|id| size_of::<String>() + id.len())
                    .sum();
                size_of::<CommittedEdit>() + names + size_of_val(&report.kept[..]) + size_of_val(&report.curve[..])
            }
            Self::Solved(solved) => return solved.frame.byte_size(),
            Self::Recorded { session, .. } => size_of::<Self>() + session.len(),
        };
        bytes as u64
    }
}

fn facts_bytes(facts: &DeformerFacts) -> usize {
    let primitives = facts.primitives.iter().map(|p| size_of_val(p) + p.name.len());
    let handles = facts.handles.iter().map(|h| size_of_val(h) + h.id.len());
    let warnings = facts.warnings.iter().map(|w| size_of_val(w) + w.message.len());
    primitives.chain(handles).chain(warnings).sum()
}
