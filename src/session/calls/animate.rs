//! The calls that animate a session's model.

use crate::session::animation::AnimationTask;
use crate::session::animation::frame_outbox::FrameOutbox;
use crate::session::animation::frame_outbox::{AnimationControl, AnimationReader, animation_ends};
use crate::session::animation::gathered_clip::gather_clip;
use crate::session::animation::running_animation::RunningAnimation;
use crate::session::answers::{AnimatedModel, Tenant};
use crate::session::audit::audit_entry::AuditedAction;
use crate::session::calls::manager::Manager;
use crate::session::capacity::memory_use::MemoryUse;
use crate::session::capacity::work_owner::WorkOwner;
use crate::session::error::Error;
use crate::wire::AnimateOrder;
use crate::wire::frames::FrameOutput;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use tracing::Instrument;

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
        let running = RunningAnimation::on_session(&session, (permit, place), &shared.metrics);
        let outbox = Arc::new(FrameOutbox::with_window(order.window));
        let held = shared.ledger.reserve_later(MemoryUse::Sessions, Some(&account));
        let ends = animation_ends(&outbox, (&shared.metrics, held), shared.gate.enter());
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
        let form = (order.played, order.root);
        let (input, output) = self.animate(tenant, id, order).await?;
        input.finish_input();
        let owner = WorkOwner {
            tenant: tenant.clone(),
            session: id.to_owned(),
        };
        let account = self.account(tenant)?;
        gather_clip((&self.shared, &account, &owner), output, form).await
    }
}
