//! The calls that commit: handles, poses, edits, undo and redo. What a call with an idempotency key answered follows from its commit,
//! so the commit alone is kept, and the answer is made again from it.

use crate::answers::{CallKey, CommittedPose, Tenant};
use crate::calls::command::{HandleChange, HistoryDirection, RecallPose, StoredAnswer};
use crate::calls::idempotency::answer_of_another_call;
use crate::calls::manager::Manager;
use crate::error::{Error, ErrorCode};
use crate::keeping::kept_session::state_facts;
use crate::store::{Commit, Store};
use bytes::Bytes;
use pliant_asset::FileSet;
use pliant_core::engine::HandleSet;
use pliant_wire::record::LoggedCommit;
use pliant_wire::{HandlePatch, PoseCommit, SessionEdit, pb};
use std::ops::ControlFlow;

impl Manager {
    /// Replaces all handles; one commit. The shape stays as it is until the next pose.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work; the old handles stay unless the new ones were stored already.
    ///
    /// # Errors
    /// What is wrong with the handles; nothing has changed then.
    pub async fn set_handles(
        &self,
        tenant: &Tenant,
        id: &str,
        handles: HandleSet,
        key: Option<CallKey>,
    ) -> Result<pb::Session, Error> {
        self.keyed_call(tenant, id, key, HandleChange::Replace(handles)).await
    }

    /// Changes some fields of one handle, or adds it; one commit. Everything else, poses included, stays.
    ///
    /// # Cancel safety
    /// As [`Manager::set_handles`].
    ///
    /// # Errors
    /// What is wrong with the handle; nothing has changed then.
    pub async fn put_handle(
        &self,
        tenant: &Tenant,
        id: &str,
        patch: HandlePatch,
        key: Option<CallKey>,
    ) -> Result<pb::Session, Error> {
        self.keyed_call(tenant, id, key, HandleChange::Put(Box::new(patch)))
            .await
    }

    /// Removes one handle; one commit.
    ///
    /// # Cancel safety
    /// As [`Manager::set_handles`].
    ///
    /// # Errors
    /// `NOT_FOUND` for the session or the handle.
    pub async fn remove_handle(
        &self,
        tenant: &Tenant,
        id: &str,
        handle_id: &str,
        key: Option<&str>,
    ) -> Result<pb::Session, Error> {
        let key = key.map(|key| CallKey {
            key: key.to_owned(),
            request: handle_id.as_bytes().to_vec(),
        });
        let change = HandleChange::Remove(handle_id.to_owned());
        self.keyed_call(tenant, id, key, change).await
    }

    /// Solves one pose and commits it.
    ///
    /// # Cancel safety
    /// Dropping the future stops the solve within a cycle; the old state stays unless the pose was committed already.
    ///
    /// # Errors
    /// What is wrong with the pose, `FAILED_PRECONDITION` without handles, `DEADLINE_EXCEEDED` when it takes
    /// longer than the server allows. Nothing has changed then.
    pub async fn solve(
        &self,
        tenant: &Tenant,
        id: &str,
        pose: PoseCommit,
        key: Option<CallKey>,
    ) -> Result<CommittedPose, Error> {
        let session = self.find(tenant, id).await?;
        match self.claim_call(&session, key, &pose).await? {
            ControlFlow::Break(solved) => Ok(solved),
            ControlFlow::Continue(claim) => {
                self.shared.metrics.poses_received.inc();
                self.call(&session, claim, pose).await
            }
        }
    }

    /// Goes back by one commit and restores positions exactly.
    ///
    /// # Cancel safety
    /// Dropping the future leaves the session in the old or in the new state.
    ///
    /// # Errors
    /// `FAILED_PRECONDITION` when nothing is left to undo.
    pub async fn undo(&self, tenant: &Tenant, id: &str, key: Option<&str>) -> Result<pb::Session, Error> {
        self.keyed_call(tenant, id, key.map(bare_key), HistoryDirection::Undo)
            .await
    }

    /// Goes forward again by one undone commit.
    ///
    /// # Cancel safety
    /// As [`Manager::undo`].
    ///
    /// # Errors
    /// `FAILED_PRECONDITION` when nothing is left to redo.
    pub async fn redo(&self, tenant: &Tenant, id: &str, key: Option<&str>) -> Result<pb::Session, Error> {
        self.keyed_call(tenant, id, key.map(bare_key), HistoryDirection::Redo)
            .await
    }
}

/// A key of a call that has no request beside its path.
fn bare_key(key: &str) -> CallKey {
    CallKey {
        key: key.to_owned(),
        request: Vec::new(),
    }
}

impl Manager {
    /// Changes the topology; one commit. The current shape becomes the rest shape, unless the edit is asked for on the rest
    /// shape. Handles keep the vertices that are left of them.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work; the old state stays unless the edit was committed already.
    ///
    /// # Errors
    /// What is wrong with the edit; `FAILED_PRECONDITION` when the surface does not allow it; `NOT_FOUND` also for a session
    /// to merge with or to wrap onto. Nothing has changed then.
    pub async fn edit(
        &self,
        tenant: &Tenant,
        id: &str,
        mut edit: SessionEdit,
        key: Option<CallKey>,
    ) -> Result<pb::EditResult, Error> {
        let session = self.find(tenant, id).await?;
        let claim = match self.claim_call(&session, key, &edit).await? {
            ControlFlow::Break(edited) => return Ok(edited),
            ControlFlow::Continue(claim) => claim,
        };
        // Before the session's own task is asked, which may be that of the same session.
        let field = format!("{}.session", edit.edit.kind().name());
        if let (Some(other), Some(session)) = (edit.edit.other_model_mut(), &edit.other_session) {
            other.files = self.export_files(tenant, session, &field).await?;
        }
        self.call(&session, claim, edit).await
    }

    /// A session's model in its current shape.
    pub(super) async fn export_files(&self, tenant: &Tenant, id: &str, field: &str) -> Result<FileSet, Error> {
        let named = |e: Error| match (e.code, &e.owner) {
            (ErrorCode::NotFound, _) => Error {
                field: Some(field.to_owned()),
                ..e
            },
            // Who asks must not go there with this call: it is about a session that is here.
            (ErrorCode::Unavailable, Some(owner)) => Error {
                field: Some(field.to_owned()),
                ..Error::new(
                    ErrorCode::FailedPrecondition,
                    format!(
                        "{field}: \"{id}\" is at another node, \"{}\" at {}; export its model, which the call for that \
                         finds there, and give the model",
                        owner.node, owner.address
                    ),
                )
            },
            _ => e,
        };
        let exported = self.export(tenant, id, None).await.map_err(named)?;
        let mut files = FileSet::single(format!("session.{}", exported.format.name()), exported.written.main);
        for (uri, bytes) in exported.written.companions {
            files.companions.insert(uri, Bytes::from(bytes));
        }
        Ok(files)
    }
}

impl Manager {
    /// An answer that is kept, brought back from the store where only its commit is known.
    pub(crate) async fn kept_answer(&self, tenant: &Tenant, answer: StoredAnswer) -> Result<StoredAnswer, Error> {
        let StoredAnswer::Recorded { session, sequence } = answer else {
            return Ok(answer);
        };
        let store = self.shared.store.as_ref().ok_or_else(answer_of_another_call)?;
        let gone = || {
            let text = "the call with this idempotency key was carried out, but what it changed is gone since";
            Error::new(ErrorCode::AlreadyExists, text)
        };
        let stored = store.commit(&session, sequence).await?.ok_or_else(gone)?;
        match &stored.record {
            LoggedCommit::Edit { report, .. } => Ok(StoredAnswer::Edited(Box::new(pb::EditResult {
                revision: stored.revision,
                ..(**report).clone()
            }))),
            LoggedCommit::Pose { frame, .. } => {
                let frame = frame.clone().ok_or_else(answer_of_another_call)?;
                let open = self.find(tenant, &session).await?;
                let revision = stored.revision;
                let recalled = self.call(&open, None, RecallPose { revision, frame }).await?;
                recalled
                    .map(|pose| StoredAnswer::Solved(Box::new(pose)))
                    .ok_or_else(gone)
            }
            _ => {
                let open = self.find(tenant, &session).await?;
                let described = self.state_then(store, &stored, open.describe()).await?;
                Ok(StoredAnswer::Session(Box::new(described)))
            }
        }
    }

    /// A session as it was after a commit.
    async fn state_then(&self, store: &Store, stored: &Commit, now: pb::Session) -> Result<pb::Session, Error> {
        let missing = || Error::new(ErrorCode::DataLoss, "a commit that a later one names is missing");
        let mut parts = Vec::with_capacity(2);
        for sequence in [stored.facts_at, stored.poses_at] {
            let part = store.commit(&now.id, sequence).await?.ok_or_else(missing)?;
            parts.push(part.record);
        }
        Ok(pb::Session {
            id: now.id,
            revision: stored.revision,
            created_at: now.created_at,
            expires_at: now.expires_at,
            label: now.label,
            ..state_facts(&parts[0], &parts[1])?
        })
    }
}
