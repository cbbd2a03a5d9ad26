//! The calls that a session's task serves, one at a time.

use crate::asset::Format;
use crate::engine::{self, ModelShape, TopologyState};
use crate::exec::Exec;
use crate::mesh::carry::CarriedFrame;
use crate::progress::Progress as _;
use crate::session::answers::{CarriedAlong, CommittedPose, ExportedModel, SessionFacts};
use crate::session::calls::command::{HistoryDirection, PendingCall, SessionCommand, StoredAnswer, WorkOrder};
use crate::session::calls::handle_change::HandleChange;
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::WorkKind;
use crate::session::capacity::work_watch::Work;
use crate::session::engine::Engine;
use crate::session::error::{Error, ErrorCode};
use crate::session::history::loaded_deformer::{LoadedDeformer, PoseAnswer};
use crate::session::history::session_state::{CommittedHandles, SessionState, ShapeRecipe};
use crate::session::registry::OpenSession;
use crate::session::stream::frame_window::FrameContext;
use crate::session::task::session_task::{SessionTask, no_handles};
use crate::wire::record::LoggedCommit;
use crate::wire::{CarryOrder, DeformOptions, PoseCommit};
use glam::DVec3;
use std::sync::Arc;
use std::time::Instant;

/// Points times triangles up to which carrying points along takes a moment even if each point is compared with each
/// triangle, as where triangles are as long as the model.
const FEW_COMPARISONS: u64 = 100_000_000;
/// What [`HandleSet::cost`] is at most where setting handles is a moment's work: sixteen half-spaces on a surface of 125,000
/// vertices.
const LIGHT_HANDLES: u64 = 16 << 18;

/// Triangles up to which comparing each with each is a moment's work, as where a pose collapses the surface.
const FEW_TRIANGLES: u32 = 10_000;

/// The lane of a commit with such options: counting crossings may compare each triangle with each.
pub(in crate::session) fn lane_of_commit(state: &SessionState, options: &DeformOptions) -> WorkLane {
    let is_light = !options.output.self_intersections || state.facts.model.counts.faces <= FEW_TRIANGLES;
    match is_light {
        true => WorkLane::Interactive,
        false => WorkLane::Builds,
    }
}

/// The lane of work that sets handles of a cost.
fn lane_of_cost(cost: u64) -> WorkLane {
    match cost <= LIGHT_HANDLES {
        true => WorkLane::Interactive,
        false => WorkLane::Builds,
    }
}

impl SessionTask {
    /// Serves a call, unless its caller no longer waits.
    pub async fn serve_command(&mut self, command: SessionCommand) {
        self.session.line.begin();
        let (who, cancel) = command.caller();
        if !cancel.cancelled() {
            self.acting = Arc::clone(who);
            let begun = Instant::now();
            self.answer_command(command).await;
            self.session.line.note_service(begun.elapsed());
        }
    }

    async fn answer_command(&mut self, command: SessionCommand) {
        match command {
            SessionCommand::SetHandles(change, call) => {
                let result = self.set_handles(change, &call).await;
                send_answer(call, result, |session| {
                    Some(StoredAnswer::Session(Box::new(session.clone())))
                });
            }
            SessionCommand::Step(direction, call) => {
                let result = self.step_history(direction, &call).await;
                send_answer(call, result, |session| {
                    Some(StoredAnswer::Session(Box::new(session.clone())))
                });
            }
            SessionCommand::Solve(request, call) => {
                let result = self.solve(*request, &call).await;
                send_answer(call, result, |solved| {
                    Some(StoredAnswer::Solved(Box::new(solved.clone())))
                });
            }
            SessionCommand::Edit(request, call) => {
                let result = self.edit(*request, &call).await;
                send_answer(call, result, |result| {
                    Some(StoredAnswer::Edited(Box::new(result.clone())))
                });
            }
            SessionCommand::Recall(revision, frame, call) => {
                let limit = self.shared.config.build;
                let order = || call.order(WorkKind::Recall, WorkLane::Interactive, limit);
                let result = self.recall(revision, *frame, order).await;
                send_answer(call, result, |_| None);
            }
            SessionCommand::Export(format, call) => {
                let result = self.export(format, &call).await;
                send_answer(call, result, |_| None);
            }
            SessionCommand::Animate(order, outbox, call) => {
                let result = self.prepare_animation(*order, outbox, &call).await;
                send_answer(call, result, |_| None);
            }
            SessionCommand::Carry(order, call) => {
                let result = self.carry_along(*order, &call).await;
                send_answer(call, result, |_| None);
            }
        }
    }

    async fn set_handles(
        &mut self,
        change: HandleChange,
        call: &PendingCall<SessionFacts>,
    ) -> Result<SessionFacts, Error> {
        let state = self.history.current();
        let set = change.apply_to(&state.handles.set, &state.poses)?;
        let limit = self.shared.config.build;
        let topology = state.topology.clone();
        let lane = lane_of_cost(state.cost_of_handles(&set));
        let (poses, facts, stages) = loop {
            let room = self.memory.room();
            let (set, topology) = (set.clone(), topology.clone());
            let (replaced, watch) = self
                .compute(call.order(WorkKind::Handles, lane, limit), move |deformer, work| {
                    deformer.replace_handles(topology.as_ref(), &set, room, &work.exec())
                })
                .await?;
            match replaced {
                Ok((poses, facts)) => break (poses, facts, watch.take_stage_ms()),
                Err(e) if self.found_room(&e, room).await => {}
                Err(e) => return Err(self.memory_failure(e, room, &watch)),
            }
        };
        let commit = || LoggedCommit::Handles {
            set: set.clone(),
            poses: poses.clone(),
            facts: facts.clone(),
        };
        self.keep_handles(commit, call.claim.as_ref()).await?;
        self.shared.metrics.observe_stages(&stages);
        self.build_ms.extend(stages);
        self.history.commit_handles(set, poses, facts);
        if let Some(deformer) = &mut self.deformer {
            deformer.adopt_handles(self.history.current().handles.id);
        }
        self.session.streams.all().iter().for_each(|m| m.forget_dragged_poses());
        self.shared.metrics.commits.inc();
        self.publish_view();
        Ok(self.session.describe())
    }

    async fn solve(&mut self, request: PoseCommit, call: &PendingCall<CommittedPose>) -> Result<CommittedPose, Error> {
        let state = self.history.current().clone();
        if state.handles.set.handles.is_empty() {
            return Err(no_handles());
        }
        let PoseCommit { seq, changes, options } = request;
        let (revision, part_bytes) = (self.history.revision() + 1, self.shared.config.part_bytes);
        let order = call.order(
            WorkKind::Solve,
            lane_of_commit(&state, &options),
            self.shared.config.solve,
        );
        let (solved, watch) = self
            .compute(order, move |deformer, work| {
                deformer.load_state(state.topology.as_ref(), &state.handles, &work.exec())?;
                let poses = deformer.engine.change_poses(&state.poses, &changes)?;
                let frames = FrameContext {
                    revision,
                    topology: state.topology.as_ref().map(TopologyState::id),
                    diagonal: state.diagonal,
                    queued: work.queued,
                    part_bytes,
                };
                let mut answer = deformer.solve_for_commit(seq, poses, &options, &frames, work)?;
                answer.frame = answer.frame.for_new_reader();
                Ok::<_, engine::Error>(answer)
            })
            .await?;
        let PoseAnswer { frame, cycles, commit } = solved.map_err(|e| self.failure(e, &watch))?;
        let posed = commit.ok_or_else(|| Error::new(ErrorCode::Internal, "a solved pose is not to be committed"))?;
        let digest = self.commit_pose(posed, &frame, cycles, call.claim.as_ref()).await?;
        self.shared.metrics.frames_sent.inc();
        Ok(CommittedPose {
            frame,
            revision,
            digest,
        })
    }

    async fn step_history(
        &mut self,
        direction: HistoryDirection,
        call: &PendingCall<SessionFacts>,
    ) -> Result<SessionFacts, Error> {
        let (target, nothing) = match direction {
            HistoryDirection::Undo => (self.history.undo_target(), "nothing is left to undo"),
            HistoryDirection::Redo => (self.history.redo_target(), "nothing is left to redo"),
        };
        let nothing = || Error::new(ErrorCode::FailedPrecondition, nothing);
        let index = target.ok_or_else(nothing)?;
        let limit = self.shared.config.build;
        let shape = self
            .shape_of_commit(index, call.order(WorkKind::History, WorkLane::Interactive, limit))
            .await?
            .ok_or_else(nothing)?;
        self.keep_step(direction, index, call.claim.as_ref()).await?;
        self.history.go_to_commit(index, shape);
        self.session.streams.all().iter().for_each(|m| m.forget_dragged_poses());
        self.publish_view();
        Ok(self.session.describe())
    }

    /// The lane of work that needs `handles`, which are set first where the engine has others.
    pub fn lane_with_handles(&self, lane: WorkLane, state: &SessionState, handles: &CommittedHandles) -> WorkLane {
        let is_loaded = self.deformer.as_ref().is_some_and(|d| d.has_loaded(handles.id));
        match is_loaded {
            false if lane_of_cost(state.cost_of_handles(&handles.set)) == WorkLane::Builds => WorkLane::Builds,
            _ => lane,
        }
    }

    /// The shape of commit `index`, solved again where it is not at hand; `None` when there is no such commit.
    pub async fn shape_of_commit(&mut self, index: usize, mut order: WorkOrder) -> Result<Option<ModelShape>, Error> {
        let Some(state) = self.history.state(index) else {
            return Ok(None);
        };
        let recipe = match self.history.shape(state.shape) {
            Ok(shape) => return Ok(Some(shape)),
            Err(recipe) => recipe,
        };
        if let ShapeRecipe::Solved { handles, .. } = &recipe {
            order.lane = self.lane_with_handles(order.lane, state, handles);
        }
        let (recorded, diagonal) = (state.digest.clone(), state.diagonal);
        let replay = move |deformer: &mut LoadedDeformer, work: &Work<'_>| deformer.solve_recipe(&recipe, &work.exec());
        let (shape, watch) = self.compute(order, replay).await?;
        let shape = shape.map_err(|e| self.failure(e, &watch))?;
        let now = engine::digest(&shape.positions);
        if now != recorded {
            self.check_solved_again(index, &now, &shape, diagonal).await?;
        }
        Ok(Some(shape))
    }

    async fn carry_along(
        &mut self,
        order: CarryOrder,
        call: &PendingCall<CarriedAlong>,
    ) -> Result<CarriedAlong, Error> {
        let view = self.session.view();
        let limit = self.shared.config.build;
        let positions = Arc::clone(&view.positions);
        let topology = self.history.current().topology.clone();
        let triangles = u64::from(self.history.current().facts.model.counts.faces);
        let comparisons = (order.points.len() as u64).saturating_mul(triangles);
        let lane = match order.model.is_none() && comparisons <= FEW_COMPARISONS {
            true => WorkLane::Interactive,
            false => WorkLane::Builds,
        };
        let (carried, watch) = self
            .compute(call.order(WorkKind::Carry, lane, limit), move |deformer, work| {
                let exec = work.exec();
                deformer.go_to_topology(topology.as_ref(), &exec)?;
                carry_order_along(deformer.engine.as_ref(), &positions, order, &exec)
            })
            .await?;
        let (frames, model) = carried.map_err(|e| self.failure(e, &watch))?;
        Ok(CarriedAlong {
            revision: view.revision,
            frames,
            model,
        })
    }

    async fn export(
        &mut self,
        format: Option<Format>,
        call: &PendingCall<ExportedModel>,
    ) -> Result<ExportedModel, Error> {
        let view = self.session.view();
        let format = format.unwrap_or(self.session.format);
        let etag = OpenSession::etag(&view, format.name());
        let limit = self.shared.config.build;
        let positions = Arc::clone(&view.positions);
        let topology = self.history.current().topology.clone();
        let (written, watch) = self
            .compute(
                call.order(WorkKind::Export, WorkLane::Interactive, limit),
                move |deformer, work| {
                    let exec = work.exec();
                    deformer.go_to_topology(topology.as_ref(), &exec)?;
                    deformer.engine.write(&positions, format, &exec)
                },
            )
            .await?;
        Ok(ExportedModel {
            written: written.map_err(|e| self.failure(e, &watch))?,
            format,
            etag,
        })
    }
}

/// Carries points and another model along with a shape.
fn carry_order_along(
    engine: &dyn Engine,
    positions: &[DVec3],
    order: CarryOrder,
    exec: &Exec<'_>,
) -> Result<(Vec<CarriedFrame>, Vec<u8>), engine::Error> {
    let mut frames = Vec::new();
    if !order.points.is_empty() {
        frames = engine.carry_points(positions, &order.points, exec)?;
        for (frame, at_rest) in frames.iter_mut().zip(order.rotations) {
            frame.rotation *= at_rest;
        }
    }
    let model = match order.model {
        Some(model) => engine.carry_model(positions, model, exec)?.main,
        None => Vec::new(),
    };
    Ok((frames, model))
}

/// Keeps the answer for the call's idempotency key and sends it to the caller.
fn send_answer<T>(call: PendingCall<T>, result: Result<T, Error>, store: impl FnOnce(&T) -> Option<StoredAnswer>) {
    let PendingCall { reply, claim, .. } = call;
    if let (Some(claim), Ok(value)) = (claim, &result)
        && let Some(stored) = store(value)
    {
        let bytes = stored.byte_size();
        claim.complete(stored, bytes);
    }
    // The caller may have gone; the change stands.
    let _ = reply.send(result);
}
