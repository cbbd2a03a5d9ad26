//! The calls that read a session's shape, the stream that deforms it, and the calls that animate its model.

use crate::animation::AnimationTask;
use crate::animation::animation_task::RunningAnimation;
use crate::animation::animation_task::gather_clip;
use crate::animation::frame_outbox::{AnimationControl, AnimationReader, FrameOutbox, animation_ends};
use crate::answers::{AnimatedModel, ExportedModel, PositionBuffer, Tenant, TransferredModel, WorkOwner};
use crate::audit::audit_entry::AuditedAction;
use crate::calls::command::{ExportModel, ReadShape, ShapeReader};
use crate::calls::manager::Manager;
use crate::capacity::memory_use::MemoryUse;
use crate::error::{Error, ErrorCode};
use crate::registry::OpenSession;
use crate::stream::ends::{StreamInput, StreamOutput, stream_ends};
use crate::stream::mailbox::Mailbox;
use glam::DVec3;
use pliant_asset::Format;
use pliant_core::engine;
use pliant_core::engine::Deformer;
use pliant_exec::Exec;
use pliant_wire::frames::{FrameOutput, f32_bytes};
use pliant_wire::{AnimateOrder, CarryOrder, CrossingsOrder, MakeRigOrder, TransferOrder, origin_of, pb};
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use tracing::Instrument;

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

    /// Reads the current committed shape on the compute threads: `read` gets the deformer, the positions and the threads, and needs at most
    /// so many bytes for each render vertex. Nothing changes.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work where `read` looks.
    ///
    /// # Errors
    /// `NOT_FOUND`; what `read` fails with.
    pub async fn look<T: Send + 'static>(
        &self,
        tenant: &Tenant,
        id: &str,
        bytes_per_vertex: u64,
        read: impl FnOnce(&Deformer, &[DVec3], &Exec<'_>) -> Result<T, engine::Error> + Send + 'static,
    ) -> Result<T, Error> {
        let session = self.find(tenant, id).await?;
        let read: ShapeReader = Box::new(|deformer, positions, exec| Ok(Box::new(read(deformer, positions, exec)?)));
        let order = ReadShape { bytes_per_vertex, read };
        let seen = self.call(&session, None, order).await?;
        self.note(tenant, AuditedAction::Look, id).await;
        let other = || Error::new(ErrorCode::Internal, "what was read of a shape is of another type");
        Ok(*seen.downcast().map_err(|_| other())?)
    }

    /// Carries points, and another model, along with the current committed shape. Nothing changes.
    ///
    /// # Cancel safety
    /// Dropping the future discards what was carried.
    ///
    /// # Errors
    /// `NOT_FOUND`; what is wrong with the model that is to be carried.
    pub async fn carry(&self, tenant: &Tenant, id: &str, order: CarryOrder) -> Result<pb::CarryResponse, Error> {
        let session = self.find(tenant, id).await?;
        let carried = self.call(&session, None, order).await?;
        self.note(tenant, AuditedAction::Carry, id).await;
        Ok(carried)
    }

    /// Finds the triangles of the current committed shape that cross others. Nothing changes.
    ///
    /// # Cancel safety
    /// Dropping the future stops the search.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn crossings(
        &self,
        tenant: &Tenant,
        id: &str,
        order: CrossingsOrder,
    ) -> Result<pb::CrossingsResponse, Error> {
        let session = self.find(tenant, id).await?;
        let found = self.call(&session, None, order).await?;
        self.note(tenant, AuditedAction::Crossings, id).await;
        Ok(found)
    }

    /// Makes a rig of a session's model in its rest pose. Nothing changes.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work.
    ///
    /// # Errors
    /// `NOT_FOUND`, `INVALID_ARGUMENT` for a clip that drives no body, or a model that has no place for some joint.
    pub async fn make_rig(&self, tenant: &Tenant, id: &str, order: MakeRigOrder) -> Result<pb::MakeRigResponse, Error> {
        let session = self.find(tenant, id).await?;
        let made = self.call(&session, None, order).await?;
        self.note(tenant, AuditedAction::Rig, id).await;
        Ok(made)
    }

    /// The model in its current committed shape with what comes to it from another one. Nothing changes.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work.
    ///
    /// # Errors
    /// `NOT_FOUND`, also for a session to take it from; what is wrong with the other model; `FAILED_PRECONDITION` where it cannot be
    /// wrapped onto this one.
    pub async fn transfer(
        &self,
        tenant: &Tenant,
        id: &str,
        mut order: TransferOrder,
    ) -> Result<TransferredModel, Error> {
        let session = self.find(tenant, id).await?;
        if let Some(other) = &order.other_session {
            order.command.source.files = self.export_files(tenant, other, "session").await?;
        }
        let came = self.call(&session, None, order).await?;
        self.note(tenant, AuditedAction::Transfer, id).await;
        Ok(came)
    }

    /// The current committed positions as one buffer.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn positions(&self, tenant: &Tenant, id: &str) -> Result<PositionBuffer, Error> {
        let view = self.find(tenant, id).await?.view();
        let etag = OpenSession::etag(&view, "f32");
        let origin = origin_of(&view.facts);
        let encode = move || f32_bytes(&view.positions, origin);
        let bytes = self.shared.compute.offload(encode).await?;
        self.note(tenant, AuditedAction::Export, id).await;
        Ok(PositionBuffer { bytes, etag, origin })
    }

    /// Opens an interactive stream on a session. It starts from the committed poses. Dropping its output stops its solve within one cycle
    /// and frees its place.
    ///
    /// # Errors
    /// `NOT_FOUND`, `RESOURCE_EXHAUSTED` when the session has as many streams as allowed, `UNAVAILABLE` while draining.
    pub async fn stream(&self, tenant: &Tenant, id: &str) -> Result<(StreamInput, StreamOutput), Error> {
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
            let of_targets = self.shared.ledger.reserve_later(MemoryUse::Sessions, Some(&account));
            let mailbox = Mailbox::new(
                &session.id,
                &self.who,
                config,
                Arc::clone(&metrics),
                Arc::clone(&session.wake),
                of_targets,
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
        let stream = stream_ends(mailbox, session, metrics, held, inside, place);
        // A drain that began meanwhile may have missed this stream.
        if self.shared.draining.load(SeqCst) {
            Err(Error::draining())
        } else {
            Ok(stream)
        }
    }
}

impl Manager {
    /// Drives a session's model by a clip. The animation uses the rest shape as it is now; handles, shape and history
    /// do not affect it, and may change meanwhile. The output reports errors of the clip or the rig.
    ///
    /// # Errors
    /// `NOT_FOUND`, `RESOURCE_EXHAUSTED` when as many animations are under way as allowed, `UNAVAILABLE` while draining.
    pub async fn animate(
        &self,
        tenant: &Tenant,
        id: &str,
        order: AnimateOrder,
    ) -> Result<(AnimationControl, AnimationReader), Error> {
        let session = self.find(tenant, id).await?;
        let shared = &self.shared;
        if shared.draining.load(SeqCst) {
            return Err(Error::draining());
        }
        let permit = Arc::clone(&shared.animations).try_acquire_owned().map_err(|_| {
            shared.metrics.refused.inc();
            let most = shared.config.animations;
            Error::exhausted(format!("{most} animations are under way, no more are allowed"), 5)
        })?;
        let account = self.account(tenant)?;
        account.check_work()?;
        let place = account.take_stream().inspect_err(|_| {
            shared.metrics.refused.inc();
        })?;
        self.note(tenant, AuditedAction::Animate, id).await;
        let running = RunningAnimation::on_session(&session, permit, place, &shared.metrics);
        let outbox = Arc::new(FrameOutbox::with_window(order.window));
        let held = shared.ledger.reserve_later(MemoryUse::Sessions, Some(&account));
        let ends = animation_ends(&outbox, &shared.metrics, held, shared.gate.enter());
        let task = AnimationTask {
            manager: self.clone(),
            session,
            outbox,
            running,
        };
        // Its work is part of the call.
        tokio::spawn(task.run_animation(order).in_current_span());
        Ok(ends)
    }

    /// As [`Manager::animate`], as a GLB that plays the clip.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work.
    ///
    /// # Errors
    /// Those of [`Manager::animate`]; what is wrong with clip or rig; `FAILED_PRECONDITION` for a model that edits have changed.
    pub async fn animate_to_model(
        &self,
        tenant: &Tenant,
        id: &str,
        mut order: AnimateOrder,
    ) -> Result<AnimatedModel, Error> {
        order.output = FrameOutput::default();
        let (form, root) = (order.played, order.root);
        let (input, output) = self.animate(tenant, id, order).await?;
        input.finish_input();
        let owner = WorkOwner {
            tenant: tenant.clone(),
            session: id.to_owned(),
        };
        let account = self.account(tenant)?;
        gather_clip(&self.shared, &account, &owner, output, form, root).await
    }
}
