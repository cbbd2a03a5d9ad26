//! Edits of the topology: the call of a manager, and what a session's task does for it.

use super::actor::Actor;
use super::commits::{Recipe, State};
use super::idempotency::Claimed;
use super::requests::{Call, Command, Edit, Stored};
use super::stop::Stop;
use super::{Code, Error, Manager, Tenant};
use crate::asset::FileSet;
use crate::engine::EditCommand;
use crate::exec::Exec;
use crate::wire;
use crate::wire::pb;
use bytes::Bytes;
use prost::Message as _;
use std::sync::Arc;

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
        request: pb::EditRequest,
        key: Option<&str>,
    ) -> Result<pb::EditResult, Error> {
        let session = self.find(tenant, &request.session_id)?;
        let claim = match self.claim(tenant, key, "edit", &[&request.encode_to_vec()])? {
            Some(Claimed::Done(Stored::Edited(result))) => return Ok(*result),
            Some(Claimed::Done(_)) => return Err(Error::new(Code::Internal, "the kept answer is of another call")),
            Some(Claimed::New(claim)) => Some(claim),
            None => None,
        };
        // Before the session's own task is asked, which may be that of the same session.
        let other = match &request.operation {
            Some(pb::edit_request::Operation::Merge(merge)) => match &merge.source {
                Some(pb::edit_request::merge::Source::Session(id)) => Some(self.files(tenant, id).await?),
                _ => None,
            },
            _ => None,
        };
        self.call(&session, claim, |call| {
            Command::Edit(Box::new(Edit { request, other }), call)
        })
        .await
    }

    /// A session's model in its current shape.
    async fn files(&self, tenant: &Tenant, id: &str) -> Result<FileSet, Error> {
        let named = |e: Error| match e.code {
            Code::NotFound => Error {
                field: Some("merge.session".into()),
                ..e
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

impl Actor {
    /// Of an edit that takes more memory than is free now, but not more than the server has, that it may fit later.
    fn too_large(&self, error: wire::Error, room: u64, stop: &Stop) -> Error {
        match error {
            wire::Error::TooLarge { seen, limit, .. } if limit == room && seen <= self.shared.budget.total() => {
                self.shared.metrics.refused.inc();
                Error::exhausted(
                    format!("the session would need {seen} bytes of memory after the edit, {room} are free"),
                    5,
                )
            }
            error => self.failure(error, stop),
        }
    }

    pub(super) async fn edit(&mut self, edit: Edit, call: &Call<pb::EditResult>) -> Result<pb::EditResult, Error> {
        let state = self.history.current().clone();
        let (shape, recipe) = (self.history.shape(state.shape), self.history.recipe(state.shape));
        let limit = self.shared.config.build;
        // What the other sessions leave, now: the engine was opened when there was more or less.
        let room = self.memory.room();
        let (done, stop) = self
            .compute(
                &call.cancel,
                limit,
                move |bench, pool, stop, _| -> Result<_, wire::Error> {
                    bench.load(state.trail.as_ref(), &state.handles, &Exec::new(pool, stop))?;
                    bench.engine.limit_memory(room);
                    // What is known of a shape beside its vertices depends on its recipe alone, never on what the engine
                    // happens to remember.
                    let shape = match shape {
                        Ok(shape) if bench.engine.remembers(&shape) => shape,
                        _ => bench.replay(&recipe, &Exec::new(pool, stop))?,
                    };
                    let settings = match &recipe {
                        Recipe::Solved { settings, .. } => Some(settings),
                        Recipe::Rest { .. } => None,
                    };
                    let order = EditCommand {
                        request: &edit.request,
                        shape: &shape,
                        poses: &state.poses,
                        settings,
                        other: edit.other,
                    };
                    let trail = state.trail.as_ref();
                    let outcome = bench.edit(trail, &state.handles, &order, &Exec::new(pool, stop))?;
                    let engine = &bench.engine;
                    Ok((outcome, engine.facts(), engine.trail(), engine.diagonal()))
                },
            )
            .await?;
        let (outcome, facts, trail, diagonal) = done.map_err(|e| self.too_large(e, room, &stop))?;
        let stages = stop.take_stage_ms();
        let mut result = outcome.result;
        let state = State {
            trail,
            diagonal,
            handles: Arc::new(outcome.handles),
            poses: outcome.poses,
            facts: Arc::new(facts),
            // Numbered by the history.
            shape: 0,
            digest: result.digest.clone(),
        };
        self.history.commit_edit(state, outcome.positions, outcome.solved);
        if let Some(bench) = &mut self.bench {
            bench.adopt(&self.history.current().handles);
        }
        self.session.streams.all().iter().for_each(|m| m.forget_overlay());
        self.shared.metrics.commits.inc();
        self.publish();
        result.ms = stages.into_iter().collect();
        result.revision = self.history.revision();
        Ok(result)
    }
}
