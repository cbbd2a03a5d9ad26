//! The calls that commit: handles, poses, undo and redo.

use crate::engine::HandleSet;
use crate::session::answers::{CallKey, CommittedPose, SessionFacts, Tenant};
use crate::session::calls::command::{HistoryDirection, SessionCommand, StoredAnswer};
use crate::session::calls::handle_change::HandleChange;
use crate::session::calls::idempotency::{ClaimOutcome, answer_of_another_call};
use crate::session::calls::manager::Manager;
use crate::session::error::Error;
use crate::session::registry::OpenSession;
use crate::wire::{HandlePatch, PoseCommit};
use std::sync::Arc;

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
    ) -> Result<SessionFacts, Error> {
        let session = self.find(tenant, id).await?;
        let claim = self.claim_request(tenant, id, key.as_ref(), "set_handles").await?;
        self.change_handles(&session, HandleChange::Replace(handles), claim)
            .await
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
    ) -> Result<SessionFacts, Error> {
        let session = self.find(tenant, id).await?;
        let claim = self.claim_request(tenant, id, key.as_ref(), "put_handle").await?;
        self.change_handles(&session, HandleChange::Put(Box::new(patch)), claim)
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
    ) -> Result<SessionFacts, Error> {
        let session = self.find(tenant, id).await?;
        let claim = self
            .claim(tenant, key, "remove_handle", &[id.as_bytes(), handle_id.as_bytes()])
            .await?;
        self.change_handles(&session, HandleChange::Remove(handle_id.to_owned()), claim)
            .await
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
        let claim = match self.claim_request(tenant, id, key.as_ref(), "solve").await? {
            Some(ClaimOutcome::Done(answer)) => match self.kept_answer(tenant, answer).await? {
                StoredAnswer::Solved(solved) => return Ok(*solved),
                _ => return Err(answer_of_another_call()),
            },
            Some(ClaimOutcome::New(claim)) => Some(claim),
            None => None,
        };
        self.shared.metrics.poses_received.inc();
        self.call(&session, claim, |call| SessionCommand::Solve(Box::new(pose), call))
            .await
    }

    /// Goes back by one commit and restores positions exactly.
    ///
    /// # Cancel safety
    /// Dropping the future leaves the session in the old or in the new state.
    ///
    /// # Errors
    /// `FAILED_PRECONDITION` when nothing is left to undo.
    pub async fn undo(&self, tenant: &Tenant, id: &str, key: Option<&str>) -> Result<SessionFacts, Error> {
        self.step_history(tenant, id, HistoryDirection::Undo, key).await
    }

    /// Goes forward again by one undone commit.
    ///
    /// # Cancel safety
    /// As [`Manager::undo`].
    ///
    /// # Errors
    /// `FAILED_PRECONDITION` when nothing is left to redo.
    pub async fn redo(&self, tenant: &Tenant, id: &str, key: Option<&str>) -> Result<SessionFacts, Error> {
        self.step_history(tenant, id, HistoryDirection::Redo, key).await
    }

    /// Claims the key of a call that changes session `id`, or gives the answer that is kept for it.
    pub(in crate::session) async fn claim_request(
        &self,
        tenant: &Tenant,
        id: &str,
        key: Option<&CallKey>,
        operation: &str,
    ) -> Result<Option<ClaimOutcome<StoredAnswer>>, Error> {
        let request = key.map_or(&[][..], |k| &k.request);
        let key = key.map(|k| k.key.as_str());
        self.claim(tenant, key, operation, &[id.as_bytes(), request]).await
    }

    async fn change_handles(
        &self,
        session: &Arc<OpenSession>,
        change: HandleChange,
        claim: Option<ClaimOutcome<StoredAnswer>>,
    ) -> Result<SessionFacts, Error> {
        self.call_for_session(session, claim, |call| SessionCommand::SetHandles(change, call))
            .await
    }

    async fn step_history(
        &self,
        tenant: &Tenant,
        id: &str,
        direction: HistoryDirection,
        key: Option<&str>,
    ) -> Result<SessionFacts, Error> {
        let session = self.find(tenant, id).await?;
        let operation = if direction == HistoryDirection::Undo {
            "undo"
        } else {
            "redo"
        };
        let claim = self.claim(tenant, key, operation, &[id.as_bytes()]).await?;
        self.call_for_session(&session, claim, |call| SessionCommand::Step(direction, call))
            .await
    }
}
