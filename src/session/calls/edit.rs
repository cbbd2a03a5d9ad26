//! The call that edits a session's topology.

use crate::asset::FileSet;
use crate::engine::Edit;
use crate::session::answers::{CallKey, Tenant};
use crate::session::calls::manager::Manager;
use crate::session::error::{Error, ErrorCode};
use crate::wire::{SessionEdit, pb};
use bytes::Bytes;
use std::ops::ControlFlow;

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
        if let (Edit::Merge(merge), Some(other)) = (&mut edit.edit, &edit.merged_session) {
            merge.files = self.export_files(tenant, other).await?;
        }
        self.call(&session, claim, edit).await
    }

    /// A session's model in its current shape.
    async fn export_files(&self, tenant: &Tenant, id: &str) -> Result<FileSet, Error> {
        let named = |e: Error| match (e.code, &e.owner) {
            (ErrorCode::NotFound, _) => Error {
                field: Some("merge.session".into()),
                ..e
            },
            // Who asks must not go there with this call: it is about a session that is here.
            (ErrorCode::Unavailable, Some(owner)) => Error {
                field: Some("merge.session".into()),
                ..Error::new(
                    ErrorCode::FailedPrecondition,
                    format!(
                        "merge.session: \"{id}\" is at another node, \"{}\" at {}; export its model, which the call for that \
                         finds there, and merge the model",
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
