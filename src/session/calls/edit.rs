//! The call that edits a session's topology.

use crate::asset::FileSet;
use crate::session::answers::{CallKey, CommittedEdit, Tenant};
use crate::session::calls::manager::Manager;
use crate::session::error::{Error, ErrorCode};
use crate::wire::SessionEdit;
use bytes::Bytes;

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
        edit: SessionEdit,
        key: Option<CallKey>,
    ) -> Result<CommittedEdit, Error> {
        self.keyed_call(tenant, id, key, edit).await
    }

    /// A session's model in its current shape.
    pub(in crate::session) async fn export_files(&self, tenant: &Tenant, id: &str) -> Result<FileSet, Error> {
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
