//! The call that edits a session's topology.

use crate::asset::FileSet;
use crate::session::answers::Tenant;
use crate::session::calls::command::{EditCall, SessionCommand, StoredAnswer};
use crate::session::calls::idempotency::ClaimOutcome;
use crate::session::calls::manager::Manager;
use crate::session::error::{Error, ErrorCode};
use crate::wire::{self, pb};
use bytes::Bytes;
use prost::Message as _;

impl Manager {
    /// Changes the topology; one commit. The current shape becomes the rest shape, unless the edit is asked for on the rest
    /// shape. Handles keep the vertices that are left of them.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work; the old state stays unless the edit was committed already.
    ///
    /// # Errors
    /// What is wrong with the edit; `FAILED_PRECONDITION` when the surface does not allow it; `NOT_FOUND` also for a session
    /// to merge with. Nothing has changed then.
    pub async fn edit(
        &self,
        tenant: &Tenant,
        request: pb::EditRequest,
        key: Option<&str>,
    ) -> Result<pb::EditResult, Error> {
        let session = self.find(tenant, &request.session_id)?;
        let claim = match self.claim(tenant, key, "edit", &[&request.encode_to_vec()])? {
            Some(ClaimOutcome::Done(StoredAnswer::Edited(result))) => return Ok(*result),
            Some(ClaimOutcome::Done(_)) => {
                return Err(Error::new(ErrorCode::Internal, "the kept answer is of another call"));
            }
            Some(ClaimOutcome::New(claim)) => Some(claim),
            None => None,
        };
        // Before the session's own task is asked, which may be that of the same session.
        let other = match &request.operation {
            Some(pb::edit_request::Operation::Merge(merge)) => match &merge.source {
                Some(pb::edit_request::merge::Source::Session(id)) => Some(self.export_files(tenant, id).await?),
                _ => None,
            },
            _ => None,
        };
        let (edit, on) = wire::edit(&request, other.as_ref())?;
        self.call(&session, claim, |call| {
            SessionCommand::Edit(Box::new(EditCall { edit, on }), call)
        })
        .await
    }

    /// A session's model in its current shape.
    async fn export_files(&self, tenant: &Tenant, id: &str) -> Result<FileSet, Error> {
        let named = |e: Error| match e.code {
            ErrorCode::NotFound => Error {
                field: Some("merge.session".into()),
                ..e
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
