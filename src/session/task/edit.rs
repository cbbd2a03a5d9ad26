//! Edits of the topology by a session's task.

use crate::engine;
use crate::session::calls::command::CallOrigin;
use crate::session::calls::model_opening::memory_needed;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::memory_ledger::MemoryShortage;
use crate::session::capacity::work_span::WorkKind;
use crate::session::capacity::work_watch::WorkWatch;
use crate::session::error::Error;
use crate::session::keeping::made_room::make_room;
use crate::session::task::commands::RunCall;
use crate::session::task::session_task::SessionTask;
use crate::wire::{SessionEdit, pb};
use std::sync::Arc;

impl SessionTask {
    /// Of a change that takes more memory than is free now, but not more than the server has, that it may fit later.
    pub fn memory_failure(&self, error: engine::Error, room: u64, watch: &WorkWatch) -> Error {
        match memory_needed(&error, room).filter(|needed| *needed <= self.shared.ledger.total()) {
            Some(needed) => {
                self.shared.metrics.refused.inc();
                let shortage = self.memory.shortage(needed);
                let text = format!(
                    "the session would need {needed} bytes of memory, and {shortage}; {} of them are the session's own",
                    self.memory.bytes()
                );
                Error::exhausted(text, 5)
            }
            None => self.failure(error, watch),
        }
    }

    /// Whether a change that found too little memory free may try again, because idle sessions have left it meanwhile.
    pub async fn found_room(&mut self, error: &engine::Error, room: u64) -> bool {
        let needed = memory_needed(error, room).filter(|needed| *needed <= self.shared.ledger.total());
        let Some(shortage) = needed.map(|needed| self.memory.shortage(needed)) else {
            return false;
        };
        let of_tenant = matches!(shortage, MemoryShortage::Tenant { .. }).then_some(&self.session.tenant);
        make_room(&self.shared, of_tenant).await
    }
}

impl RunCall for SessionEdit {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<pb::EditResult, Error> {
        let limit = task.shared.config.build;
        let edit = Arc::new(self);
        let (edited, shape, mut report, watch) = loop {
            let state = task.history.current().clone();
            let (shape, recipe) = (task.history.shape(state.shape), task.history.recipe(state.shape));
            // What the other sessions leave, now: the engine was opened when there was more or less.
            let room = task.memory.room();
            let edit = Arc::clone(&edit);
            let (done, watch) = task
                .compute(
                    origin.order(WorkKind::Edit, WorkLane::Builds, limit),
                    move |deformer, work| {
                        deformer.room = room;
                        deformer.edit_state(&state, shape.ok(), &recipe, &edit, &work.exec())
                    },
                )
                .await?;
            match done {
                Ok((edited, shape, report)) => break (edited, shape, report, watch),
                Err(e) if task.found_room(&e, room).await => {}
                Err(e) => return Err(task.memory_failure(e, room, &watch)),
            }
        };
        let ms = watch.take_stage_ms();
        task.shared.metrics.observe_stages(&ms);
        let kept_edit = task.kept.is_some().then(|| Arc::unwrap_or_clone(edit));
        task.keep_edit(kept_edit, &edited, (&shape, &report), origin.claim.as_ref())
            .await?;
        task.history.commit_edit(edited, shape);
        if let Some(deformer) = &mut task.deformer {
            deformer.adopt_handles(task.history.current().handles.id);
        }
        task.session.streams.all().iter().for_each(|m| m.forget_dragged_poses());
        task.shared.metrics.commits.inc();
        task.publish_view();
        report.revision = task.history.revision();
        report.ms = ms;
        Ok(report)
    }
}
