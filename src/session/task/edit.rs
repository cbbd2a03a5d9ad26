//! Edits of the topology by a session's task.

use crate::engine;
use crate::exec::Exec;
use crate::session::answers::CommittedEdit;
use crate::session::calls::command::PendingCall;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_watch::WorkWatch;
use crate::session::error::Error;
use crate::session::history::loaded_deformer::EditStart;
use crate::session::task::session_task::SessionTask;
use crate::wire::SessionEdit;

impl SessionTask {
    /// Of a change that takes more memory than is free now, but not more than the server has, that it may fit later.
    pub fn memory_failure(&self, error: engine::Error, room: u64, watch: &WorkWatch) -> Error {
        match error {
            engine::Error::TooLarge { seen, limit, .. } if limit == room && seen <= self.shared.ledger.total() => {
                self.shared.metrics.refused.inc();
                Error::exhausted(
                    format!("the session would need {seen} bytes of memory, {room} are free"),
                    5,
                )
            }
            error => self.failure(error, watch),
        }
    }

    pub async fn edit(&mut self, edit: SessionEdit, call: &PendingCall<CommittedEdit>) -> Result<CommittedEdit, Error> {
        let state = self.history.current().clone();
        let (shape, recipe) = (self.history.shape(state.shape), self.history.recipe(state.shape));
        let limit = self.shared.config.build;
        // What the other sessions leave, now: the engine was opened when there was more or less.
        let room = self.memory.room().min(self.place.room());
        let kept_edit = self.kept.is_some().then(|| edit.clone());
        let (done, watch) = self
            .compute(
                call.order("edit", WorkLane::Builds, limit),
                move |deformer, pool, watch, _| {
                    let start = EditStart {
                        state: &state,
                        shape,
                        recipe: &recipe,
                    };
                    deformer.edit_state(start, &edit, room, &Exec::new(pool, watch))
                },
            )
            .await?;
        let (edited, shape, report) = done.map_err(|e| self.memory_failure(e, room, &watch))?;
        self.refuse_beyond_memory()?;
        let ms = watch.take_stage_ms();
        self.shared.metrics.observe_stages(&ms);
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
