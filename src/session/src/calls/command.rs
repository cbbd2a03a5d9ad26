//! What a session's task is asked to do: calls in a queue, each with its caller. The largest kind are changes of the handles.

use crate::animation::frame_outbox::FrameOutbox;
use crate::animation::frame_outbox::PreparedAnimation;
use crate::answers::{CommittedPose, ExportedModel, TransferredModel};
use crate::calls::idempotency::{KeyClaim, RequestFingerprint, answer_of_another_call};
use crate::capacity::compute_slots::WorkLane;
use crate::capacity::work_watch::WorkKind;
use crate::error::{Error, ErrorCode};
use glam::DVec3;
use pliant_asset::Format;
use pliant_core::engine;
use pliant_core::engine::{Deformer, Handle, HandlePose, HandlePoses, HandleSet};
use pliant_exec::Exec;
use pliant_exec::progress::CancelFlag;
use pliant_wire::record::AnsweredFrame;
use pliant_wire::{
    AnimateOrder, CarryOrder, CrossingsOrder, HandlePatch, MakeRigOrder, PoseCommit, SessionEdit, TransferOrder, pb,
};
use prost::Message as _;
use std::any::Any;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use tracing::Span;

/// A call that a session's task serves.
pub(crate) trait TaskCall: Sized {
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
pub(crate) trait KeyedCall: TaskCall<Answer: TryFrom<StoredAnswer, Error = Error>> {
    /// Its name among the operations that keys stand for.
    fn operation(&self) -> &'static str;

    /// The hash of the request on session `id`.
    fn fingerprint(&self, id: &str, request: &[u8]) -> RequestFingerprint {
        RequestFingerprint::of(self.operation(), &[id.as_bytes(), request])
    }
}

/// Where a call comes from.
#[derive(Debug)]
pub(crate) struct CallOrigin {
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
pub(crate) struct QueuedCall<C: TaskCall> {
    pub call: C,
    pub origin: CallOrigin,
    pub reply: oneshot::Sender<Result<C::Answer, Error>>,
}

/// Gives each kind of call its answer and its place in the queue. Answers of calls that commit are kept for their keys.
macro_rules! session_calls {
    ($($kind:ident: $call:ty => $answer:ty $(, kept by $stored:expr)?;)*) => {
        /// A call of any kind in the queue of a session's task.
        pub(crate) enum SessionCommand {
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
    Carry: CarryOrder => pb::CarryResponse;
    Crossings: CrossingsOrder => pb::CrossingsResponse;
    MakeRig: MakeRigOrder => pb::MakeRigResponse;
    Transfer: TransferOrder => TransferredModel;
    Animate: PrepareAnimation => PreparedAnimation;
    Look: ReadShape => Box<dyn Any + Send>;
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
pub(crate) struct RecallPose {
    pub revision: u64,
    pub frame: Box<AnsweredFrame>,
}

/// The model in its current shape, in a format or the one that it came in.
pub(crate) struct ExportModel(pub Option<Format>);

/// Reads the rest shape, the positions of the current committed shape, and whatever else a deformer knows of its model.
pub(crate) type ShapeReader =
    Box<dyn FnOnce(&Deformer, &[DVec3], &Exec<'_>) -> Result<Box<dyn Any + Send>, engine::Error> + Send>;

/// Reads the current committed shape, with at most so many bytes of scratch for each vertex.
pub(crate) struct ReadShape {
    pub bytes_per_vertex: u64,
    pub read: ShapeReader,
}

/// Prepares an animation and reports stages to its reader.
pub(crate) struct PrepareAnimation {
    pub order: AnimateOrder,
    pub outbox: Arc<FrameOutbox>,
}

/// Along the commits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HistoryDirection {
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
pub(crate) struct WorkOrder {
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
pub(crate) enum StoredAnswer {
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

/// A change of the handles.
#[derive(Debug)]
pub(crate) enum HandleChange {
    /// All are replaced; without a pose: the rest pose. One that is set again as it is keeps the point that it turns about.
    Replace(HandleSet),
    /// The named fields of one handle are replaced, or it is added. Everything else stays where it is.
    Put(Box<HandlePatch>),
    /// One is removed. The others stay where they are.
    Remove(String),
}

impl HandleChange {
    /// The handles after the change; `poses` are those in force.
    ///
    /// # Errors
    /// `NOT_FOUND` when the handle to remove does not exist, `INVALID_ARGUMENT` when one to add has no region.
    pub fn apply_to(self, current: &HandleSet, poses: &HandlePoses) -> Result<HandleSet, Error> {
        match self {
            Self::Replace(set) => Ok(keeping_pivots(set, current, poses)),
            Self::Put(patch) => {
                let mut next = set_at_poses(current, poses);
                let index = next.handles.iter().position(|h| h.id == patch.id);
                match index.and_then(|k| next.handles.get_mut(k)) {
                    Some(handle) => patch.apply_to(handle),
                    None => next.handles.push(new_handle(*patch, next.handles.len())?),
                }
                Ok(next)
            }
            Self::Remove(id) => {
                let mut next = set_at_poses(current, poses);
                next.handles.retain(|h| h.id != id);
                if next.handles.len() == current.handles.len() {
                    let shown: String = id.chars().take(128).collect();
                    return Err(Error::new(ErrorCode::NotFound, format!("no handle \"{shown}\"")));
                }
                Ok(next)
            }
        }
    }
}

/// Poses with the pivots that they have now: where joints are depends on all handles, and one that comes or goes is not to move the
/// others.
pub(crate) fn with_pivots(poses: &HandlePoses, handles: &[pb::HandleFacts]) -> HandlePoses {
    let pinned = poses.0.iter().zip(handles).map(|(pose, facts)| match facts.pivot[..] {
        [x, y, z] if pose.moves() && !pose.free_rotation => HandlePose {
            pivot: pose.pivot.or(Some([x, y, z].into())),
            ..pose.clone()
        },
        _ => pose.clone(),
    });
    HandlePoses(Arc::new(pinned.collect()))
}

/// The set with the pivots of `poses` where a handle, its region and its pose are those of `current`, but for a pivot that the pose
/// does not name.
fn keeping_pivots(mut set: HandleSet, current: &HandleSet, poses: &HandlePoses) -> HandleSet {
    for handle in &mut set.handles {
        let is_same = |(old, _): &(&Handle, &HandlePose)| old.id == handle.id && old.region == handle.region;
        let old = current.handles.iter().zip(poses.0.iter()).find(is_same);
        if let (Some(pose), Some((_, old))) = (&mut handle.pose, old) {
            let kept = HandlePose {
                pivot: old.pivot,
                ..pose.clone()
            };
            if pose.pivot.is_none() && kept == *old {
                *pose = kept;
            }
        }
    }
    set
}

/// The set with every handle set where it is now.
fn set_at_poses(current: &HandleSet, poses: &HandlePoses) -> HandleSet {
    let mut next = current.clone();
    for (handle, pose) in next.handles.iter_mut().zip(poses.0.iter()) {
        handle.pose = (*pose != HandlePose::default()).then(|| pose.clone());
    }
    next
}

/// The handle that a patch adds as number `k`. Its region is missing only when the handle that the patch was meant for has
/// gone since it was read.
fn new_handle(mut patch: HandlePatch, k: usize) -> Result<Handle, Error> {
    let field = format!("handles[{k}].region");
    let region = patch.region.take();
    let region = region.ok_or_else(|| Error::invalid(field, "is missing, and the handle is not set any more"))?;
    let mut handle = Handle::new(patch.id.clone(), region);
    patch.apply_to(&mut handle);
    Ok(handle)
}

#[cfg(test)]
mod handle_change_tests {
    use super::*;
    use pliant_core::engine::Region;

    fn handle(id: &str, x: Option<f64>) -> Handle {
        Handle {
            pose: x.map(|x| HandlePose::translation([x, 0.0, 0.0])),
            ..Handle::new(id, Region::Component(0)).soft(2.0)
        }
    }

    fn patch(id: &str) -> HandlePatch {
        HandlePatch {
            id: id.into(),
            ..Default::default()
        }
    }

    fn put(patch: HandlePatch, current: &HandleSet, poses: &HandlePoses) -> Result<HandleSet, Error> {
        HandleChange::Put(Box::new(patch)).apply_to(current, poses)
    }

    fn x_of(handle: &Handle) -> Option<f64> {
        handle.pose.as_ref().and_then(|p| p.translation).map(|by| by.x)
    }

    #[test]
    fn a_patch_changes_what_it_names_and_moves_nothing_else() {
        let current = HandleSet::from([handle("a", None), handle("b", Some(1.0))]);
        // Since then, a was dragged and committed.
        let dragged = vec![HandlePose::translation([7.0, 0.0, 0.0]), HandlePose::default()];
        let poses = HandlePoses(dragged.into());

        let rigid = HandlePatch {
            rigid: Some(true),
            ..patch("b")
        };
        let next = put(rigid, &current, &poses).expect("known");
        assert_eq!((x_of(&next.handles[0]), x_of(&next.handles[1])), (Some(7.0), None));
        assert_eq!((next.handles[1].rigid, next.handles[1].stiffness), (true, Some(2.0)));

        let moved = HandlePatch {
            stiffness: Some(None),
            pose: Some(Some(HandlePose::translation([3.0, 0.0, 0.0]))),
            ..patch("a")
        };
        let next = put(moved, &current, &poses).expect("known");
        assert_eq!((x_of(&next.handles[0]), next.handles[0].stiffness), (Some(3.0), None));

        let added = HandlePatch {
            region: Some(Region::Component(1)),
            ..patch("c")
        };
        let next = put(added, &current, &poses).expect("added");
        assert_eq!((next.handles.len(), next.handles[2].stiffness), (3, None));
        let nowhere = put(patch("c"), &current, &poses).expect_err("it has no region");
        assert_eq!(nowhere.field.as_deref(), Some("handles[2].region"));

        let next = HandleChange::Remove("b".into())
            .apply_to(&current, &poses)
            .expect("known");
        assert_eq!((next.handles.len(), x_of(&next.handles[0])), (1, Some(7.0)));
        let unknown = HandleChange::Remove("z".into()).apply_to(&current, &poses);
        assert_eq!(unknown.expect_err("unknown").http_status(), 404);
    }
}
