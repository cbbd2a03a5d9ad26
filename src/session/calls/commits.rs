//! The calls that commit: handles, poses, undo and redo.

use crate::engine::HandleSet;
use crate::session::answers::{CallKey, CommittedPose, Tenant};
use crate::session::calls::command::HistoryDirection;
use crate::session::calls::handle_change::HandleChange;
use crate::session::calls::manager::Manager;
use crate::session::error::Error;
use crate::wire::{HandlePatch, PoseCommit, pb};
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
