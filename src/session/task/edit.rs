//! Edits of the topology by a session's task.

use crate::engine;
use crate::session::answers::CommittedEdit;
use crate::session::calls::command::PendingCall;
use crate::session::calls::model_opening::memory_needed;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::memory_ledger::MemoryShortage;
use crate::session::capacity::work_span::WorkKind;
use crate::session::capacity::work_watch::WorkWatch;
use crate::session::error::Error;
use crate::session::history::loaded_deformer::EditStart;
use crate::session::keeping::made_room::make_room;
use crate::session::task::session_task::SessionTask;
use crate::wire::SessionEdit;
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

    pub async fn edit(&mut self, edit: SessionEdit, call: &PendingCall<CommittedEdit>) -> Result<CommittedEdit, Error> {
        let limit = self.shared.config.build;
        let edit = Arc::new(edit);
        let (edited, shape, report, watch) = loop {
            let state = self.history.current().clone();
            let (shape, recipe) = (self.history.shape(state.shape), self.history.recipe(state.shape));
            // What the other sessions leave, now: the engine was opened when there was more or less.
            let room = self.memory.room();
            let edit = Arc::clone(&edit);
            let (done, watch) = self
                .compute(
                    call.order(WorkKind::Edit, WorkLane::Builds, limit),
                    move |deformer, work| {
                        let start = EditStart {
                            state: &state,
                            shape,
                            recipe: &recipe,
                        };
                        deformer.edit_state(start, &edit, room, &work.exec())
                    },
                )
                .await?;
            match done {
                Ok((edited, shape, report)) => break (edited, shape, report, watch),
                Err(e) if self.found_room(&e, room).await => {}
                Err(e) => return Err(self.memory_failure(e, room, &watch)),
            }
        };
        let ms = watch.take_stage_ms();
        self.shared.metrics.observe_stages(&ms);
        let kept_edit = self.kept.is_some().then(|| Arc::unwrap_or_clone(edit));
        self.keep_edit(kept_edit, &edited, (&shape, &report), call.claim.as_ref())
            .await?;
        self.history.commit_edit(edited, shape);
        if let Some(deformer) = &mut self.deformer {
            deformer.adopt_handles(self.history.current().handles.id);
        }
        self.session.streams.all().iter().for_each(|m| m.forget_dragged_poses());
        self.shared.metrics.commits.inc();
        self.publish_view();
        Ok(CommittedEdit {
            report,
            revision: self.history.revision(),
            ms,
        })
    }
}
