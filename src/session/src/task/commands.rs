//! The calls that a session's task serves, one at a time: handles, poses, edits, exports, and preparing an animation.

use crate::animation::frame_outbox::PreparedAnimation;
use crate::animation::frame_outbox::StageReporter;
use crate::answers::{CommittedPose, ExportedModel, TransferredModel};
use crate::calls::command::{
    CallOrigin, ExportModel, HandleChange, HistoryDirection, PrepareAnimation, QueuedCall, RecallPose, SessionCommand,
    TaskCall, WorkOrder, with_pivots,
};
use crate::calls::model_opening::{count_refusal, memory_needed, no_place};
use crate::capacity::compute_slots::WorkLane;
use crate::capacity::memory_ledger::MemoryShortage;
use crate::capacity::work_watch::{Work, WorkKind, WorkWatch};
use crate::error::{Error, ErrorCode};
use crate::history::loaded_deformer::{LoadedDeformer, PoseAnswer};
use crate::history::session_state::{CommittedHandles, SessionState, ShapeRecipe};
use crate::keeping::sweep::evict_idle;
use crate::registry::OpenSession;
use crate::task::adopted_parts::AdoptedParts;
use crate::task::session_task::{SessionTask, no_handles};
use glam::DVec3;
use pliant_asset::WrittenFiles;
use pliant_core::engine;
use pliant_core::engine::{Animation, ClipSource, Deformer, ModelShape, PoseChain, RigOrder, left_out_of_rig};
use pliant_exec::Exec;
use pliant_exec::progress::Progress as _;
use pliant_mesh::CrossingPairs;
use pliant_motion::bvh::read_bvh;
use pliant_wire::record::LoggedCommit;
use pliant_wire::{
    CarryOrder, CrossingsOrder, DeformOptions, MakeRigOrder, PoseCommit, SessionEdit, TransferOrder, made_rig_message,
    origin_of, pb, transfer_report, written_warnings,
};
use std::sync::Arc;
use std::time::Instant;

/// Points times triangles up to which carrying points along takes a moment even if each point is compared with each
/// triangle, as where triangles are as long as the model.
const FEW_COMPARISONS: u64 = 100_000_000;
/// What [`HandleSet::cost`] is at most where setting handles is a moment's work: sixteen half-spaces on a surface of 125,000
/// vertices.
const LIGHT_HANDLES: u64 = 16 << 18;

/// Triangles up to which comparing each with each is a moment's work, as where a pose collapses the surface.
pub(super) const FEW_TRIANGLES: u32 = 10_000;

/// The lane of a commit with such options: counting crossings may compare each triangle with each.
pub(crate) fn lane_of_commit(state: &SessionState, options: &DeformOptions) -> WorkLane {
    lane_of_work(!options.output.self_intersections || state.triangles() <= FEW_TRIANGLES)
}

/// The lane of work that is a moment's, or not.
pub(super) fn lane_of_work(is_light: bool) -> WorkLane {
    match is_light {
        true => WorkLane::Interactive,
        false => WorkLane::Builds,
    }
}

/// A call, served on the session's task.
pub(super) trait RunCall: TaskCall {
    fn run(
        self,
        task: &mut SessionTask,
        origin: &CallOrigin,
    ) -> impl Future<Output = Result<Self::Answer, Error>> + Send;
}

impl SessionTask {
    /// Serves a call of any kind.
    pub async fn serve_command(&mut self, command: SessionCommand) {
        match command {
            SessionCommand::Handles(call) => self.serve(*call).await,
            SessionCommand::Solve(call) => self.serve(*call).await,
            SessionCommand::Step(call) => self.serve(*call).await,
            SessionCommand::Edit(call) => self.serve(*call).await,
            SessionCommand::Recall(call) => self.serve(*call).await,
            SessionCommand::Export(call) => self.serve(*call).await,
            SessionCommand::Carry(call) => self.serve(*call).await,
            SessionCommand::Crossings(call) => self.serve(*call).await,
            SessionCommand::MakeRig(call) => self.serve(*call).await,
            SessionCommand::Transfer(call) => self.serve(*call).await,
            SessionCommand::Animate(call) => self.serve(*call).await,
            SessionCommand::Look(call) => self.serve(*call).await,
        }
    }

    /// Serves a call, unless its caller no longer waits; keeps the answer for its key and sends it to the caller.
    async fn serve<C: RunCall>(&mut self, queued: QueuedCall<C>) {
        let QueuedCall { call, origin, reply } = queued;
        self.session.line.begin();
        if origin.cancel.cancelled() {
            return;
        }
        self.acting = Arc::clone(&origin.who);
        let begun = Instant::now();
        let result = call.run(self, &origin).await;
        if let (Some(claim), Ok(answer)) = (origin.claim, &result)
            && let Some(stored) = C::stored(answer)
        {
            let bytes = stored.byte_size();
            claim.complete(stored, bytes);
        }
        // The caller may have gone; the change stands.
        let _ = reply.send(result);
        self.session.line.note_service(begun.elapsed());
    }

    /// The lane of work that needs `handles`, which are set first where the engine has others.
    pub fn lane_with_handles(&self, lane: WorkLane, state: &SessionState, handles: &CommittedHandles) -> WorkLane {
        let is_loaded = self.deformer.as_ref().is_some_and(|d| d.has_loaded(handles.id));
        match is_loaded {
            false if state.cost_of_handles(&handles.set) > LIGHT_HANDLES => WorkLane::Builds,
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
}
impl RunCall for HandleChange {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<pb::Session, Error> {
        let state = task.history.current().clone();
        let poses = with_pivots(&state.poses, &state.facts.handles);
        let set = self.apply_to(&state.handles.set, &poses)?;
        let limit = task.shared.config.build;
        let topology = state.topology.clone();
        let lane = lane_of_work(state.cost_of_handles(&set) <= LIGHT_HANDLES);
        let (poses, mut facts, stages) = loop {
            let room = task.memory.room();
            let (set, topology) = (set.clone(), topology.clone());
            let (replaced, watch) = task
                .compute(origin.order(WorkKind::Handles, lane, limit), move |deformer, work| {
                    deformer.room = room;
                    deformer.replace_handles(topology.as_ref(), &set, &work.exec())
                })
                .await?;
            match replaced {
                Ok((poses, facts)) => break (poses, facts, watch.take_stage_ms()),
                Err(e) if task.found_room(&e, room).await => {}
                Err(e) => return Err(task.memory_failure(e, room, &watch)),
            }
        };
        // The shape stays, and so do the turns that it has.
        for ((own, handle), pose) in facts.handles.iter_mut().zip(&set.handles).zip(poses.0.iter()) {
            let old = state.facts.handles.iter().find(|old| old.id == handle.id);
            if let Some(old) = old.filter(|_| pose.free_rotation) {
                own.found_turn.clone_from(&old.found_turn);
            }
        }
        let commit = || LoggedCommit::Handles {
            set: set.clone(),
            poses: poses.clone(),
            facts: facts.clone(),
        };
        task.keep_handles(commit, origin.claim.as_ref()).await?;
        task.shared.metrics.observe_stages(&stages);
        task.build_ms.extend(stages);
        task.history.commit_handles(set, poses, facts);
        task.adopt_new_handles();
        Ok(task.session.describe())
    }
}

impl RunCall for PoseCommit {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<CommittedPose, Error> {
        let state = task.history.current().clone();
        if state.handles.set.handles.is_empty() {
            return Err(no_handles());
        }
        let Self { seq, changes, options } = self;
        let starts = task.history.starts_from(options.from_revision)?;
        let (revision, part_bytes) = (task.history.revision() + 1, task.shared.config.part_bytes);
        let order = origin.order(
            WorkKind::Solve,
            lane_of_commit(&state, &options),
            task.shared.config.solve,
        );
        let (solved, watch) = task
            .compute(order, move |deformer, work| {
                deformer.load_state(state.topology.as_ref(), &state.handles, &work.exec())?;
                let poses = deformer.engine.change_poses(&state.poses, &changes)?;
                let frames = state.frame_context(revision, work.queued, part_bytes);
                let chain = PoseChain::of(starts, poses, options.solve);
                let mut answer = deformer.solve_for_commit(seq, chain, &options, &frames, work)?;
                answer.frame = answer.frame.for_new_reader();
                Ok::<_, engine::Error>(answer)
            })
            .await?;
        let PoseAnswer { frame, cycles, commit } = solved.map_err(|e| task.failure(e, &watch))?;
        let posed = commit.ok_or_else(|| Error::new(ErrorCode::Internal, "a solved pose is not to be committed"))?;
        let digest = task.commit_pose(posed, &frame, cycles, origin.claim.as_ref()).await?;
        task.shared.metrics.frames_sent.inc();
        Ok(CommittedPose {
            frame,
            revision,
            digest,
        })
    }
}

impl RunCall for HistoryDirection {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<pb::Session, Error> {
        let (target, nothing) = match self {
            Self::Undo => (task.history.undo_target(), "nothing is left to undo"),
            Self::Redo => (task.history.redo_target(), "nothing is left to redo"),
        };
        let nothing = || Error::new(ErrorCode::FailedPrecondition, nothing);
        let index = target.ok_or_else(nothing)?;
        let limit = task.shared.config.build;
        let shape = task
            .shape_of_commit(index, origin.order(WorkKind::History, WorkLane::Interactive, limit))
            .await?
            .ok_or_else(nothing)?;
        task.keep_step(self, index, origin.claim.as_ref()).await?;
        task.history.go_to_commit(index, shape);
        task.publish_other_handles();
        Ok(task.session.describe())
    }
}

impl RunCall for RecallPose {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<Option<CommittedPose>, Error> {
        let limit = task.shared.config.build;
        let order = || origin.order(WorkKind::Recall, WorkLane::Interactive, limit);
        task.recall(self.revision, *self.frame, order).await
    }
}

impl RunCall for CarryOrder {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<pb::CarryResponse, Error> {
        let view = task.session.view();
        let limit = task.shared.config.build;
        let positions = Arc::clone(&view.positions);
        let topology = task.history.current().topology.clone();
        let triangles = u64::from(task.history.current().triangles());
        let comparisons = (self.points.len() as u64).saturating_mul(triangles);
        let lane = lane_of_work(self.model.is_none() && comparisons <= FEW_COMPARISONS);
        let (carried, watch) = task
            .compute(origin.order(WorkKind::Carry, lane, limit), move |deformer, work| {
                let exec = work.exec();
                deformer.go_to_topology(topology.as_ref(), &exec)?;
                carry_order_along(deformer.deformer("carrying")?, &positions, self, &exec)
            })
            .await?;
        Ok(pb::CarryResponse {
            revision: view.revision,
            ..carried.map_err(|e| task.failure(e, &watch))?
        })
    }
}

impl RunCall for CrossingsOrder {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<pb::CrossingsResponse, Error> {
        let view = task.session.view();
        let state = task.history.current();
        let (positions, topology) = (Arc::clone(&view.positions), state.topology.clone());
        let lane = lane_of_work(state.triangles() <= FEW_TRIANGLES);
        let (handles, triangles) = (Arc::clone(&state.handles), state.triangles());
        let limit = task.shared.config.build;
        if self.pairs {
            let most = (u64::from(triangles).pow(2) / 2).min(self.limit as u64);
            reserve_more(task, most * BYTES_PER_PAIR, "listing the pairs")?;
        }
        let (found, watch) = task
            .compute(origin.order(WorkKind::Crossings, lane, limit), move |deformer, work| {
                let exec = work.exec();
                // Handles say what is held; triangles alone need none.
                match self.pairs {
                    true => deformer.load_state(topology.as_ref(), &handles, &exec)?,
                    false => deformer.go_to_topology(topology.as_ref(), &exec)?,
                }
                let deformer = deformer.deformer("looking for crossings")?;
                let found = deformer.crossing_triangles(&positions, &exec)?;
                let pairs = match self.pairs {
                    true => deformer.crossing_pairs(&positions, self.limit, &exec)?,
                    false => CrossingPairs::default(),
                };
                Ok::<_, engine::Error>(self.answer(&found, &pairs))
            })
            .await?;
        Ok(pb::CrossingsResponse {
            revision: view.revision,
            ..found.map_err(|e| task.failure(e, &watch))?
        })
    }
}

impl RunCall for MakeRigOrder {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<pb::MakeRigResponse, Error> {
        let topology = task.history.current().topology.clone();
        let (limit, clip_limits) = (task.shared.config.build, task.shared.config.animation_limits().clip);
        reserve_for_clip(task, self.bvh.as_ref().map_or(0, |bytes| bytes.len()))?;
        let (made, watch) = task
            .compute(
                origin.order(WorkKind::Rig, WorkLane::Builds, limit),
                move |deformer, work| {
                    let exec = work.exec();
                    deformer.go_to_topology(topology.as_ref(), &exec)?;
                    let clip = self.bvh.map(|bytes| read_bvh(&bytes, &clip_limits)).transpose()?;
                    let order = RigOrder {
                        clip: clip.as_ref(),
                        preset: self.preset.as_deref(),
                        landmarks: self.landmarks,
                        up: self.up,
                        front: self.front,
                    };
                    let deformer = deformer.deformer("making rigs")?;
                    let mut made = deformer.make_rig(&order, &exec)?;
                    made.warnings.extend(left_out_of_rig(deformer.model())?);
                    Ok::<_, engine::Error>(made_rig_message(&made))
                },
            )
            .await?;
        made.map_err(|error| named_as_in_request(task.failure(error, &watch)))
    }
}

impl RunCall for TransferOrder {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<TransferredModel, Error> {
        let view = task.session.view();
        let limit = task.shared.config.build;
        let positions = Arc::clone(&view.positions);
        let topology = task.history.current().topology.clone();
        let files = [Some(&self.command.source), self.command.shape.as_ref()];
        let files: u64 = files.into_iter().flatten().map(|other| other.files.total_bytes()).sum();
        reserve_more(task, files, "the models of a transfer")?;
        let (came, watch) = task
            .compute(
                origin.order(WorkKind::Transfer, WorkLane::Builds, limit),
                move |deformer, work| {
                    let exec = work.exec();
                    deformer.go_to_topology(topology.as_ref(), &exec)?;
                    let deformer = deformer.deformer("transfers")?;
                    deformer.transfer(&positions, &self.command, &exec)
                },
            )
            .await?;
        let came = came.map_err(|e| task.failure(e, &watch))?;
        Ok(TransferredModel {
            report: transfer_report(&came.report),
            model: ExportedModel {
                etag: OpenSession::etag(&view, came.format.name()),
                written: came.files,
                format: came.format,
            },
        })
    }
}

/// A request for a rig has its clip in the field `bvh`.
fn named_as_in_request(error: Error) -> Error {
    match error.field.as_deref() {
        Some("clip") => Error {
            field: Some("bvh".into()),
            message: error.message.replacen("clip: ", "bvh: ", 1),
            ..error
        },
        _ => error,
    }
}

impl RunCall for ExportModel {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<ExportedModel, Error> {
        let view = task.session.view();
        let format = self.0.unwrap_or(task.session.format);
        let etag = OpenSession::etag(&view, format.name());
        let limit = task.shared.config.build;
        let positions = Arc::clone(&view.positions);
        let topology = task.history.current().topology.clone();
        let (written, watch) = task
            .compute(
                origin.order(WorkKind::Export, WorkLane::Interactive, limit),
                move |deformer, work| {
                    let exec = work.exec();
                    deformer.go_to_topology(topology.as_ref(), &exec)?;
                    deformer.engine.write(&positions, format, &exec)
                },
            )
            .await?;
        Ok(ExportedModel {
            written: written.map_err(|e| task.failure(e, &watch))?,
            format,
            etag,
        })
    }
}

/// Carries points and another model along with a shape; the answer without its revision.
fn carry_order_along(
    deformer: &Deformer,
    positions: &[DVec3],
    order: CarryOrder,
    exec: &Exec<'_>,
) -> Result<pb::CarryResponse, engine::Error> {
    let mut frames = Vec::new();
    if !order.points.is_empty() {
        frames = deformer.carry_points(positions, &order.points, exec)?;
        for (frame, at_rest) in frames.iter_mut().zip(order.rotations) {
            frame.rotation *= at_rest;
        }
    }
    let written = match order.model {
        Some(model) => deformer.carry_model(positions, model, exec)?,
        None => WrittenFiles::default(),
    };
    Ok(pb::CarryResponse {
        points: frames.iter().flat_map(|f| f.position.to_array()).collect(),
        rotations: frames.iter().flat_map(|f| f.rotation.to_array()).collect(),
        scales: frames.iter().map(|f| f.scale).collect(),
        warnings: written_warnings(&written),
        model: written.main.into(),
        ..pb::CarryResponse::default()
    })
}

impl SessionTask {
    /// Of a change that takes more memory than is free now, but not more than the server has, that it may fit later.
    pub fn memory_failure(&self, error: engine::Error, room: u64, watch: &WorkWatch) -> Error {
        match memory_needed(&error, room).filter(|needed| *needed <= self.shared.ledger.total()) {
            Some(needed) => {
                let shortage = self.memory.shortage(needed);
                let text = format!(
                    "the session would need {needed} bytes of memory, and {shortage}; {} of them are the session's own",
                    self.memory.bytes()
                );
                count_refusal(&self.shared, no_place(text))
            }
            None => self.failure(error, watch),
        }
    }

    /// Publishes a change of the handles or of the commit in force: what streams have dragged is void.
    fn publish_other_handles(&mut self) {
        self.session.streams.all().iter().for_each(|m| m.forget_dragged_poses());
        self.publish_view();
    }

    /// The same after a commit whose handles the deformer has already.
    fn adopt_new_handles(&mut self) {
        if let Some(deformer) = &mut self.deformer {
            deformer.adopt_handles(self.history.current().handles.id);
        }
        self.shared.metrics.commits.inc();
        self.publish_other_handles();
    }

    /// Whether a change that found too little memory free may try again, because idle sessions have left it meanwhile.
    pub async fn found_room(&mut self, error: &engine::Error, room: u64) -> bool {
        let needed = memory_needed(error, room).filter(|needed| *needed <= self.shared.ledger.total());
        let Some(shortage) = needed.map(|needed| self.memory.shortage(needed)) else {
            return false;
        };
        let of_tenant = matches!(shortage, MemoryShortage::Tenant { .. }).then_some(&self.session.tenant);
        evict_idle(&self.shared, of_tenant).await
    }
}

impl RunCall for SessionEdit {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<pb::EditResult, Error> {
        let (revision, vertices) = (task.history.revision(), task.history.current().vertices());
        let edit = match AdoptedParts::join(&mut task.adopted_parts, self, revision, vertices)?.whole() {
            Ok(edit) => Arc::new(edit),
            Err(parts) => {
                reserve_more(task, parts.byte_size(), "keeping the parts of a shape")?;
                task.adopted_parts = Some(*parts);
                return Ok(pb::EditResult {
                    revision,
                    ..Default::default()
                });
            }
        };
        let limit = task.shared.config.build;
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
        task.keep_edit(kept_edit, &edited, &shape, &report, origin.claim.as_ref())
            .await?;
        task.history.commit_edit(edited, shape);
        task.adopt_new_handles();
        report.revision = task.history.revision();
        report.ms = ms;
        Ok(report)
    }
}

/// Bytes of memory for each pair of triangles that is listed, its part of the answer included.
const BYTES_PER_PAIR: u64 = 256;

/// Bytes of memory for each byte of a clip while it is read: a number of two digits is a number, and becomes part of a rotation.
const BYTES_PER_CLIP_BYTE: u64 = 16;

/// Takes the memory in which a clip of so many bytes is read.
fn reserve_for_clip(task: &mut SessionTask, bytes: usize) -> Result<(), Error> {
    reserve_more(
        task,
        (bytes as u64).saturating_mul(BYTES_PER_CLIP_BYTE),
        "reading the clip",
    )
}

/// Reserves memory for `what` until the call is over.
pub(super) fn reserve_more(task: &mut SessionTask, needed: u64, what: &str) -> Result<(), Error> {
    let reserved = task.memory.grow_to(task.memory.bytes().saturating_add(needed));
    reserved.map_err(|shortage| {
        let text = format!("{what} would need {needed} bytes of memory, and {shortage}");
        count_refusal(&task.shared, no_place(text))
    })
}

/// Handles, shape and history stay as they are.
impl RunCall for PrepareAnimation {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<PreparedAnimation, Error> {
        let Self { order, outbox } = self;
        let revision = task.history.revision();
        let topology = task.history.current().topology.clone();
        let relative_to = origin_of(&task.history.current().facts);
        let limits = task.shared.config.animation_limits();
        if let ClipSource::Bvh { bytes, .. } = &order.request.clip {
            reserve_for_clip(task, bytes.len())?;
        }
        let (prepared, watch) = task
            .compute(
                origin.order(WorkKind::Animate, WorkLane::Builds, task.shared.config.build),
                move |deformer, work| {
                    let reporter = StageReporter {
                        outbox: &outbox,
                        watch: work.watch,
                    };
                    let exec = &Exec::new(work.pool, &reporter);
                    deformer.go_to_topology(topology.as_ref(), exec)?;
                    let prepared = Animation::prepare(deformer.deformer("animating")?, &order.request, &limits, exec);
                    let animation = prepared.map_err(pliant_wire::of_rig)?;
                    let is_shaded = order.output.normals || order.output.tangents;
                    let shader = is_shaded.then(|| deformer.shader());
                    Ok::<_, pliant_wire::Error>((animation, shader))
                },
            )
            .await?;
        let (animation, shader) = prepared.map_err(|error| match error {
            pliant_wire::Error::Cancelled => task.failure(engine::Error::Cancelled, &watch),
            error => error.into(),
        })?;
        Ok(PreparedAnimation {
            animation,
            shader,
            revision,
            origin: relative_to,
            build_ms: watch.take_stage_ms(),
        })
    }
}
