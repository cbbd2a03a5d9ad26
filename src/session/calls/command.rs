//! What a session's task is asked to do.

use crate::asset::{FileSet, Format};
use crate::engine::{HandlePose, HandlePoses};
use crate::progress::CancelFlag;
use crate::session::answers::{ExportedModel, SolvedFrames};
use crate::session::calls::idempotency::KeyClaim;
use crate::session::error::{Error, ErrorCode};
use crate::wire::frames::FrameRequest;
use crate::wire::{DeformOptions, handle_pose_message, pb};
use std::sync::Arc;
use tokio::sync::oneshot;

/// A request and where its answer goes.
#[derive(Debug)]
pub(in crate::session) enum SessionCommand {
    SetHandles(HandleChange, PendingCall<pb::Session>),
    Solve(Box<(pb::Pose, DeformOptions)>, PendingCall<SolvedFrames>),
    /// One commit forward or back.
    Step(HistoryDirection, PendingCall<pb::Session>),
    Edit(Box<EditCall>, PendingCall<pb::EditResult>),
    Export(Option<Format>, PendingCall<ExportedModel>),
}

/// An edit, with the model of the session that it merges with.
#[derive(Debug)]
pub(in crate::session) struct EditCall {
    pub request: pb::EditRequest,
    pub other: Option<FileSet>,
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

/// A change of the handles.
#[derive(Debug)]
pub(in crate::session) enum HandleChange {
    /// All are replaced; those without a pose are at rest.
    Replace(pb::SetHandlesRequest),
    /// The named fields of one handle are replaced, or it is added. Everything else stays where it is.
    Put(Box<pb::Handle>, Vec<String>),
    /// One handle goes. The others stay where they are.
    Remove(String),
}

impl HandleChange {
    /// The handles after the change; `poses` are those in force.
    ///
    /// # Errors
    /// `NOT_FOUND` when the handle to remove does not exist.
    pub fn apply_to(
        self,
        current: &pb::SetHandlesRequest,
        poses: &HandlePoses,
    ) -> Result<pb::SetHandlesRequest, Error> {
        let kept = || {
            let mut next = current.clone();
            for (handle, pose) in next.handles.iter_mut().zip(poses.0.iter()) {
                handle.pose = (*pose != HandlePose::default()).then(|| handle_pose_message(pose));
            }
            next
        };
        match self {
            Self::Replace(request) => Ok(request),
            Self::Put(handle, fields) => {
                let mut next = kept();
                match next.handles.iter_mut().find(|h| h.id == handle.id) {
                    Some(old) => patch_handle(old, *handle, &fields),
                    None => next.handles.push(*handle),
                }
                Ok(next)
            }
            Self::Remove(id) => {
                let mut next = kept();
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

/// Takes the fields of `new` that `fields` names (JSON names).
fn patch_handle(old: &mut pb::Handle, new: pb::Handle, fields: &[String]) {
    let named = |name: &str| fields.iter().any(|f| f == name);
    // Without `..`, so that a field added to the schema cannot be forgotten here.
    let pb::Handle {
        id: _,
        region,
        constrains,
        stiffness,
        rigid,
        pose,
        falloff,
    } = new;
    if named("region") {
        old.region = region;
    }
    if named("constrains") {
        old.constrains = constrains;
    }
    if named("stiffness") {
        old.stiffness = stiffness;
    }
    if named("rigid") {
        old.rigid = rigid;
    }
    if named("pose") {
        old.pose = pose;
    }
    if named("falloff") {
        old.falloff = falloff;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn handle(id: &str, x: Option<f64>) -> pb::Handle {
        let pose = x.map(|x| pb::HandlePose {
            translation: vec![x, 0.0, 0.0],
            ..Default::default()
        });
        pb::Handle {
            id: id.into(),
            pose,
            stiffness: Some(2.0),
            ..Default::default()
        }
    }

    fn x_of(handle: &pb::Handle) -> Option<f64> {
        handle.pose.as_ref().map(|p| p.translation[0])
    }

    #[test]
    fn a_patch_changes_what_it_names_and_moves_nothing_else() {
        let handles = vec![handle("a", None), handle("b", Some(1.0))];
        let current = pb::SetHandlesRequest {
            handles,
            ..Default::default()
        };
        // Since then, a was dragged and committed.
        let poses = HandlePoses(Arc::new(vec![
            HandlePose::translation([7.0, 0.0, 0.0]),
            Default::default(),
        ]));

        let rigid = pb::Handle {
            id: "b".into(),
            rigid: true,
            ..Default::default()
        };
        let next = HandleChange::Put(Box::new(rigid.clone()), vec!["rigid".into()])
            .apply_to(&current, &poses)
            .expect("known");
        assert_eq!((x_of(&next.handles[0]), x_of(&next.handles[1])), (Some(7.0), None));
        assert_eq!((next.handles[1].rigid, next.handles[1].stiffness), (true, Some(2.0)));

        let fields = vec!["stiffness".to_owned(), "pose".to_owned()];
        let next = HandleChange::Put(Box::new(handle("a", Some(3.0))), fields)
            .apply_to(&current, &poses)
            .expect("known");
        assert_eq!(x_of(&next.handles[0]), Some(3.0));

        let next = HandleChange::Put(Box::new(handle("c", None)), Vec::new())
            .apply_to(&current, &poses)
            .expect("added");
        assert_eq!(next.handles.len(), 3);

        let next = HandleChange::Remove("b".into())
            .apply_to(&current, &poses)
            .expect("known");
        assert_eq!((next.handles.len(), x_of(&next.handles[0])), (1, Some(7.0)));
        assert_eq!(
            HandleChange::Remove("z".into())
                .apply_to(&current, &poses)
                .expect_err("unknown")
                .http_status(),
            404
        );
    }
}
