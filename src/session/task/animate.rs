//! What a session's task does for an animation: it prepares it.

use crate::engine::{self, ClipSource};
use crate::exec::Exec;
use crate::session::animation::frame_outbox::StageTeller;
use crate::session::animation::prepared_animation::PreparedAnimation;
use crate::session::calls::command::{CallOrigin, PrepareAnimation};
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::WorkKind;
use crate::session::error::Error;
use crate::session::task::commands::RunCall;
use crate::session::task::session_task::SessionTask;
use crate::wire;

/// Bytes of memory for each byte of a clip while it is read: a number of two digits is a number, and becomes part of a rotation.
const BYTES_PER_CLIP_BYTE: u64 = 16;

/// Handles, shape and history stay as they are.
impl RunCall for PrepareAnimation {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<PreparedAnimation, Error> {
        let Self { order, outbox } = self;
        let revision = task.history.revision();
        let topology = task.history.current().topology.clone();
        let limits = task.shared.config.animation_limits();
        if let ClipSource::Bvh { bytes, .. } = &order.request.clip {
            let needed = (bytes.len() as u64).saturating_mul(BYTES_PER_CLIP_BYTE);
            let reserved = task.memory.grow_to(task.memory.bytes().saturating_add(needed));
            reserved.map_err(|shortage| {
                task.shared.metrics.refused.inc();
                let text = format!("reading the clip would need {needed} bytes of memory, and {shortage}");
                Error::exhausted(text, 5)
            })?;
        }
        let (prepared, watch) = task
            .compute(
                origin.order(WorkKind::Animate, WorkLane::Builds, task.shared.config.build),
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
            wire::Error::Cancelled => task.failure(engine::Error::Cancelled, &watch),
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
