//! What a session's task is asked to do.

use crate::asset::Format;
use crate::engine::{Edit, EditedShape, HandlePose};
use crate::progress::CancelFlag;
use crate::session::answers::{ExportedModel, SolvedFrames};
use crate::session::calls::idempotency::KeyClaim;
use crate::session::calls::handle_change::HandleChange;
use crate::session::error::Error;
use crate::wire::frames::FrameRequest;
use crate::wire::{DeformOptions, pb};
use std::sync::Arc;
use tokio::sync::oneshot;

/// A request and where its answer goes.
#[derive(Debug)]
pub(in crate::session) enum SessionCommand {
    SetHandles(HandleChange, PendingCall<pb::Session>),
    Solve(Box<SolveCall>, PendingCall<SolvedFrames>),
    /// One commit forward or back.
    Step(HistoryDirection, PendingCall<pb::Session>),
    Edit(Box<EditCall>, PendingCall<pb::EditResult>),
    Export(Option<Format>, PendingCall<ExportedModel>),
}

/// Poses to solve and commit.
#[derive(Debug)]
pub(in crate::session) struct SolveCall {
    /// The number that the frame bears.
    pub seq: u64,
    /// The handles that move, and where they go.
    pub changes: Vec<(String, HandlePose)>,
    pub settings: DeformOptions,
}

/// An edit of the topology.
#[derive(Debug)]
pub(in crate::session) struct EditCall {
    pub edit: Edit,
    /// The shape that it works on.
    pub on: EditedShape,
}

/// Along the commits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::session) enum HistoryDirection {
    Undo,
    Redo,
}

/// Somebody who waits for an answer.
#[derive(Debug)]
pub(in crate::session) struct PendingCall<T> {
    pub reply: oneshot::Sender<Result<T, Error>>,
    /// Raised when nobody waits any more.
    pub cancel: Arc<CancelFlag>,
    pub claim: Option<KeyClaim<StoredAnswer>>,
}

/// An answer kept by idempotency key.
#[derive(Debug, Clone)]
pub(in crate::session) enum StoredAnswer {
    Session(Box<pb::Session>),
    Edited(Box<pb::EditResult>),
    Solved {
        frame: Box<FrameRequest>,
        revision: u64,
        digest: String,
    },
}

impl StoredAnswer {
    /// Bytes held, about.
    pub fn byte_size(&self) -> u64 {
        use prost::Message as _;
        match self {
            Self::Session(session) => session.encoded_len() as u64,
            Self::Edited(result) => result.encoded_len() as u64,
            Self::Solved { frame, .. } => {
                let shading = frame
                    .shading
                    .as_ref()
                    .map_or(0, |s| s.normals.len() * 12 + s.tangents.len() * 16);
                (size_of_val(frame.positions.as_slice()) + shading) as u64
            }
        }
    }
}
