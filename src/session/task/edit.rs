//! Edits of the topology by a session's task.

use crate::engine::{self, EditCommand};
use crate::exec::Exec;
use crate::session::answers::CommittedEdit;
use crate::session::calls::command::PendingCall;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_watch::WorkWatch;
use crate::session::error::Error;
use crate::session::history::session_state::{EditedState, ShapeRecipe};
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
        let room = self.memory.room();
        let (done, watch) = self
            .compute(
                call.order(WorkLane::Builds, limit),
                move |deformer, pool, watch, _| -> Result<_, engine::Error> {
                    let exec = &Exec::new(pool, watch);
                    deformer.load_state(state.topology.as_ref(), &state.handles, exec)?;
                    deformer.engine.limit_memory(room);
                    // What is known of a shape beside its vertices depends on its recipe alone, never on what the engine
                    // happens to remember.
                    let shape = match shape {
                        Ok(shape) if deformer.engine.remembers(shape.id) => shape,
                        _ => deformer.solve_recipe(&recipe, exec)?,
                    };
                    let settings = match &recipe {
                        ShapeRecipe::Solved { settings, .. } => Some(settings),
                        ShapeRecipe::Rest { .. } => None,
                    };
                    let command = EditCommand {
                        edit: &edit.edit,
                        on: edit.on,
                        shape: &shape,
                        poses: &state.poses,
                        settings,
                    };
                    let topology = state.topology.as_ref();
                    let outcome = deformer.edit(topology, &state.handles, &command, exec)?;
                    let engine = &deformer.engine;
                    Ok((outcome, engine.facts(), engine.topology_state(), engine.diagonal()))
                },
            )
            .await?;
        let (outcome, facts, topology, diagonal) = done.map_err(|e| self.memory_failure(e, room, &watch))?;
        self.refuse_beyond_memory()?;
        let ms = watch.take_stage_ms();
        let edited = EditedState {
            topology,
            diagonal,
            handles: outcome.handles,
            poses: outcome.poses,
            facts,
            digest: outcome.report.digest.clone(),
            solved_with: outcome.solved,
        };
        self.history.commit_edit(edited, outcome.shape);
        if let Some(deformer) = &mut self.deformer {
            deformer.adopt_handles(self.history.current().handles.id);
        }
        self.session.streams.all().iter().for_each(|m| m.forget_dragged_poses());
        self.shared.metrics.commits.inc();
        self.publish_view();
        Ok(CommittedEdit {
            report: outcome.report,
            revision: self.history.revision(),
            ms,
        })
    }
}
