//! What a session's task does for an animation: it prepares it.

use crate::engine::{self, ClipSource};
use crate::exec::Exec;
use crate::session::animation::frame_outbox::{FrameOutbox, StageTeller};
use crate::session::animation::prepared_animation::PreparedAnimation;
use crate::session::calls::command::PendingCall;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::WorkKind;
use crate::session::error::Error;
use crate::session::task::session_task::SessionTask;
use crate::wire::{self, AnimateOrder};
use std::sync::Arc;

/// Bytes of memory for each byte of a clip while it is read: a number of two digits is a number, and becomes part of a rotation.
const BYTES_PER_CLIP_BYTE: u64 = 16;

impl SessionTask {
    /// Prepares an animation of the model as it is now. Handles, shape and history stay as they are.
    pub async fn prepare_animation(
        &mut self,
        order: AnimateOrder,
        outbox: Arc<FrameOutbox>,
        call: &PendingCall<PreparedAnimation>,
    ) -> Result<PreparedAnimation, Error> {
        let revision = self.history.revision();
        let topology = self.history.current().topology.clone();
        let limits = self.shared.config.animation_limits();
        if let ClipSource::Bvh { bytes, .. } = &order.request.clip {
            let needed = (bytes.len() as u64).saturating_mul(BYTES_PER_CLIP_BYTE);
            let reserved = self.memory.grow_to(self.memory.bytes().saturating_add(needed));
            reserved.map_err(|shortage| {
                self.shared.metrics.refused.inc();
                let text = format!("reading the clip would need {needed} bytes of memory, and {shortage}");
                Error::exhausted(text, 5)
            })?;
        }
        let (prepared, watch) = self
            .compute(
                call.order(WorkKind::Animate, WorkLane::Builds, self.shared.config.build),
                move |deformer, work| {
                    let teller = StageTeller {
                        outbox: &outbox,
                        watch: work.watch,
                    };
                    let exec = &Exec::new(work.pool, &teller);
                    deformer.go_to_topology(topology.as_ref(), exec)?;
                    let prepared = deformer.engine.prepare_animation(&order.request, &limits, exec);
                    let animation = prepared.map_err(|e| wire::of_rig(e.into()))?;
                    let is_shaded = order.output.normals || order.output.tangents;
                    let shader = is_shaded.then(|| deformer.shader());
                    Ok::<_, wire::Error>((animation, shader))
                },
            )
            .await?;
        let (animation, shader) = prepared.map_err(|error| match error {
            wire::Error::Cancelled => self.failure(engine::Error::Cancelled, &watch),
            error => error.into(),
        })?;
        Ok(PreparedAnimation {
            animation,
            shader,
            revision,
            build_ms: watch.take_stage_ms(),
        })
    }
}
