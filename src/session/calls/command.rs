//! What a session's task is asked to do.

use crate::asset::Format;
use crate::engine::DeformerFacts;
use crate::progress::CancelFlag;
use crate::session::animation::frame_outbox::FrameOutbox;
use crate::session::animation::prepared_animation::PreparedAnimation;
use crate::session::answers::{CarriedAlong, CommittedEdit, CommittedPose, ExportedModel, SessionFacts};
use crate::session::calls::handle_change::HandleChange;
use crate::session::calls::idempotency::KeyClaim;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::WorkKind;
use crate::session::error::Error;
use crate::wire::record::AnsweredFrame;
use crate::wire::{AnimateOrder, CarryOrder, PoseCommit, SessionEdit};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use tracing::Span;

/// A request and where its answer goes.
#[derive(Debug)]
pub(in crate::session) enum SessionCommand {
    SetHandles(HandleChange, PendingCall<SessionFacts>),
    Solve(Box<PoseCommit>, PendingCall<CommittedPose>),
    /// One commit forward or back.
    Step(HistoryDirection, PendingCall<SessionFacts>),
    Edit(Box<SessionEdit>, PendingCall<CommittedEdit>),
    /// The answer of a pose that was committed with this revision; `None` when the history has lost it.
    Recall(u64, Box<AnsweredFrame>, PendingCall<Option<CommittedPose>>),
    Export(Option<Format>, PendingCall<ExportedModel>),
    Carry(Box<CarryOrder>, PendingCall<CarriedAlong>),
    /// Prepares an animation and reports stages to its reader.
    Animate(Box<AnimateOrder>, Arc<FrameOutbox>, PendingCall<PreparedAnimation>),
}

impl SessionCommand {
    /// The caller, for the audit trail, and its flag: raised when it no longer waits.
    pub fn caller(&self) -> (&Arc<str>, &CancelFlag) {
        match self {
            Self::SetHandles(_, PendingCall { who, cancel, .. })
            | Self::Solve(_, PendingCall { who, cancel, .. })
            | Self::Step(_, PendingCall { who, cancel, .. })
            | Self::Edit(_, PendingCall { who, cancel, .. })
            | Self::Recall(_, _, PendingCall { who, cancel, .. })
            | Self::Export(_, PendingCall { who, cancel, .. })
            | Self::Carry(_, PendingCall { who, cancel, .. })
            | Self::Animate(_, _, PendingCall { who, cancel, .. }) => (who, cancel),
        }
    }
}

/// Along the commits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::session) enum HistoryDirection {
    Undo,
    Redo,
}

/// A caller that waits for an answer.
#[derive(Debug)]
pub(in crate::session) struct PendingCall<T> {
    /// The caller, for the audit trail.
    pub who: Arc<str>,
    pub reply: oneshot::Sender<Result<T, Error>>,
    /// Raised when the caller has left.
    pub cancel: Arc<CancelFlag>,
    /// When it was asked for: waiting counts against the time it may take.
    pub arrived: Instant,
    pub claim: Option<KeyClaim<StoredAnswer>>,
    /// Of the call.
    pub span: Span,
}

impl<T> PendingCall<T> {
    /// Its work, which may take as long as `limit` from its arrival on.
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
