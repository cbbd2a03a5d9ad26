//! The calls that read a session's shape, and the stream that deforms it.

use crate::asset::Format;
use crate::session::answers::{CarriedAlong, ExportedModel, PositionBuffer, Tenant};
use crate::session::audit::audit_entry::AuditedAction;
use crate::session::calls::command::ExportModel;
use crate::session::calls::manager::Manager;
use crate::session::capacity::memory_use::MemoryUse;
use crate::session::error::Error;
use crate::session::registry::OpenSession;
use crate::session::stream::ends::DeformStream;
use crate::session::stream::mailbox::Mailbox;
use crate::wire::CarryOrder;
use crate::wire::frames::f32_bytes;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;

impl Manager {
    /// The model in its current committed shape, in `format` or the one that it came in.
    ///
    /// # Cancel safety
    /// Dropping the future discards the files.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` when the model cannot be written in that format.
    pub async fn export(&self, tenant: &Tenant, id: &str, format: Option<Format>) -> Result<ExportedModel, Error> {
        let session = self.find(tenant, id).await?;
        let exported = self.call(&session, None, ExportModel(format)).await?;
        self.note(tenant, AuditedAction::Export, id).await;
        Ok(exported)
    }

    /// The entity tag that [`Manager::export`] would answer with, for nothing.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn export_etag(&self, tenant: &Tenant, id: &str, format: Option<Format>) -> Result<String, Error> {
        let session = self.find(tenant, id).await?;
        Ok(OpenSession::etag(
            &session.view(),
            format.unwrap_or(session.format).name(),
        ))
    }

    /// Carries points, and another model, along with the current committed shape. Nothing changes.
    ///
    /// # Cancel safety
    /// Dropping the future discards what was carried.
    ///
    /// # Errors
    /// `NOT_FOUND`; what is wrong with the model that is to be carried.
    pub async fn carry(&self, tenant: &Tenant, id: &str, order: CarryOrder) -> Result<CarriedAlong, Error> {
        let session = self.find(tenant, id).await?;
        let carried = self.call(&session, None, order).await?;
        self.note(tenant, AuditedAction::Carry, id).await;
        Ok(carried)
    }

    /// The current committed positions as one buffer.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn positions(&self, tenant: &Tenant, id: &str) -> Result<PositionBuffer, Error> {
        let view = self.find(tenant, id).await?.view();
        let etag = OpenSession::etag(&view, "f32");
        let bytes = self.shared.compute.offload(move || f32_bytes(&view.positions)).await?;
        self.note(tenant, AuditedAction::Export, id).await;
        Ok(PositionBuffer { bytes, etag })
    }

    /// Opens an interactive stream on a session. It starts from the committed poses.
    ///
    /// # Errors
    /// `NOT_FOUND`, `RESOURCE_EXHAUSTED` when the session has as many streams as allowed, `UNAVAILABLE` while draining.
    pub async fn stream(&self, tenant: &Tenant, id: &str) -> Result<DeformStream, Error> {
        let mut session = self.find(tenant, id).await?;
        if self.shared.draining.load(SeqCst) {
            return Err(self.leaving().await);
        }
        let (config, metrics) = (&self.shared.config, Arc::clone(&self.shared.metrics));
        let account = self.account(tenant)?;
        let place = account.take_stream().inspect_err(|_| {
            metrics.refused.inc();
        })?;
        let mailbox = loop {
            let mailbox = Mailbox::new(
                (&session.id, &self.who),
                config,
                Arc::clone(&metrics),
                Arc::clone(&session.wake),
            );
            let mailbox = Arc::new(mailbox);
            match session.streams.add(Arc::clone(&mailbox)) {
                Ok(()) => break mailbox,
                // It left memory since it was found, and comes back for the stream.
                Err(_) if session.has_left() => {
                    tokio::task::yield_now().await;
                    session = self.find(tenant, id).await?;
                }
                Err(error) => {
                    metrics.refused.inc();
                    return Err(error);
                }
            }
        };
        let inside = self.shared.gate.enter();
        self.note(tenant, AuditedAction::Stream, id).await;
        let held = self.shared.ledger.reserve_later(MemoryUse::Sessions, Some(&account));
        let stream = DeformStream::new(mailbox, session, (metrics, held), (inside, place));
        // A drain that began meanwhile may have missed this stream.
        if self.shared.draining.load(SeqCst) {
            Err(Error::draining())
        } else {
            Ok(stream)
        }
    }
}
