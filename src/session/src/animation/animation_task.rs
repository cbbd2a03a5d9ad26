//! The task of one animation: it prepares the animation and solves its frames one by one, for a reader or as one model that plays
//! them.

use crate::animation::frame_outbox::{AnimationReader, FrameOutbox, PreparedAnimation};
use crate::answers::{AnimatedModel, AnimationAnswer, WorkOwner};
use crate::calls::command::PrepareAnimation;
use crate::calls::manager::Manager;
use crate::calls::model_opening::{count_refusal, no_place};
use crate::capacity::memory_ledger::MemoryReservation;
use crate::capacity::memory_use::MemoryUse;
use crate::capacity::work_watch::{CancelOnDrop, WorkKind, WorkSpan, WorkWatch};
use crate::error::{Error, ErrorCode};
use crate::metrics::{GaugeUnit, Metrics};
use crate::quota::tenant_account::{TenantAccount, TenantStream};
use crate::registry::OpenSession;
use crate::shared::SharedResources;
use crate::stream::frame_window::{FrameContext, ms_of};
use glam::{DVec3, Vec3};
use pliant_core::engine;
use pliant_core::engine::{FrameCursor, FrameSource, FrameSums, PlayedForm, digest};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Progress as _;
use pliant_motion::rig::RigidMotion;
use pliant_wire::frames::{Frame, FrameOutput};
use pliant_wire::{AnimateOrder, AnimationSummary, RootMotion, pb, quality_message};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::OwnedSemaphorePermit;
use tracing::Span;

/// An animation on its way to its reader.
pub(crate) struct AnimationTask {
    pub manager: Manager,
    pub session: Arc<OpenSession>,
    pub outbox: Arc<FrameOutbox>,
    /// Its place among those under way.
    pub running: RunningAnimation,
}

/// What solving a frame needs, wherever it runs.
struct FrameSolver {
    prepared: Arc<PreparedAnimation>,
    frames: FrameContext,
    root: RootMotion,
    output: FrameOutput,
}

/// What came of one step of a cursor.
struct SolvedFrame {
    cursor: FrameCursor,
    sums: FrameSums,
    /// `None` for a frame that only leads to one that is wanted.
    frame: Option<Frame>,
    cycles: usize,
}

impl AnimationTask {
    /// Runs until the last frame is sent, or none is wanted any more.
    pub async fn run_animation(self, order: AnimateOrder) {
        let ended = tokio::select! {
            biased;
            () = self.session.closing.cancelled() => Err(self.session.why()),
            ended = self.prepare_and_solve(order) => ended,
        };
        match ended {
            Ok(Some(summary)) => self.outbox.complete(summary),
            Ok(None) => {}
            Err(error) => self.outbox.end_early(Some(error)),
        }
        tracing::debug!(session.id = %self.session.id, "animation ended");
        drop(self.running);
    }

    /// The report of all frames; `None` when they are no longer wanted.
    async fn prepare_and_solve(&self, order: AnimateOrder) -> Result<Option<AnimationSummary>, Error> {
        let (root, output) = (order.root, order.output);
        let outbox = Arc::clone(&self.outbox);
        let call = PrepareAnimation { order, outbox };
        let mut prepared = tokio::select! {
            prepared = self.manager.call(&self.session, None, call) => prepared?,
            () = self.outbox.wait_for_end() => return Ok(None),
        };
        let memory = self.reserve_memory(&prepared)?;
        let summary = AnimationSummary {
            handles: prepared.animation.handle_facts().to_vec(),
            feet: prepared.animation.feet().to_vec(),
            warnings: prepared.animation.warnings(),
            scale: prepared.animation.driver().scale(),
            build_ms: std::mem::take(&mut prepared.build_ms),
            ..Default::default()
        };
        let prepared = Arc::new(prepared);
        self.outbox.set_prepared(Arc::clone(&prepared));
        let solver = FrameSolver {
            frames: FrameContext {
                revision: prepared.revision,
                topology: None,
                diagonal: prepared.animation.diagonal(),
                origin: prepared.origin,
                queued: Duration::ZERO,
                part_bytes: self.manager.shared.config.part_bytes,
            },
            prepared,
            root,
            output,
        };
        self.solve_frames(Arc::new(solver), Arc::new(memory), summary).await
    }

    /// The bytes that it needs of what all sessions together may hold.
    fn reserve_memory(&self, prepared: &PreparedAnimation) -> Result<MemoryReservation, Error> {
        let bytes = prepared.byte_size();
        let shared = &self.manager.shared;
        let account = self.manager.account(&self.session.tenant)?;
        let reserved = (shared.ledger).reserve(MemoryUse::Sessions, Some(&account), bytes, bytes);
        reserved.map_err(|shortage| {
            let text = format!("the animation would need {bytes} bytes of memory, and {shortage}");
            count_refusal(shared, no_place(text))
        })
    }

    async fn solve_frames(
        &self,
        solver: Arc<FrameSolver>,
        memory: Arc<MemoryReservation>,
        mut summary: AnimationSummary,
    ) -> Result<Option<AnimationSummary>, Error> {
        let shared = &self.manager.shared;
        let prepared = &solver.prepared;
        let mut cursor = prepared.animation.cursor(prepared.animation.range().clone());
        let owner = self.session.work_owner();
        let begun = Instant::now();
        while cursor.next_index().is_some() {
            if let Some(fraction) = cursor.lead_progress() {
                self.outbox.report_stage("frames before those of a block", fraction);
            }
            if !self.outbox.wait_for_room().await {
                return Ok(None);
            }
            let slot = tokio::select! {
                slot = shared.compute.slot_for_frame(&owner) => slot?,
                () = self.outbox.wait_for_end() => return Ok(None),
            };
            let flags = vec![Arc::clone(&self.outbox.cancel), Arc::clone(&self.session.cancel)];
            let watch = WorkWatch::new(flags, shared.config.solve);
            let watch = Arc::new(watch.within(Arc::clone(&memory), prepared.byte_size()));
            let (inside, frames, sums) = (Arc::clone(&watch), Arc::clone(&solver), summary.sums);
            let queued = slot.queued;
            let span = WorkSpan::new(WorkKind::Frame, &self.session.id, &Span::current());
            let solved = slot
                .run(span, move |pool| frames.solve_next(cursor, sums, &inside, pool))
                .await
                .map_err(|panicked| {
                    tracing::error!(session.id = %self.session.id, panic = panicked.0, "an animation panicked");
                    Error::from(panicked)
                })?;
            let solved = match solved {
                Ok(solved) => solved,
                Err(error) => return self.unsolved(error, &watch),
            };
            SolvedFrame { cursor, .. } = solved;
            summary.sums = solved.sums;
            let _ = memory.resize(prepared.byte_size() + cursor.byte_size());
            shared.metrics.cycles.inc_by(solved.cycles as u64);
            shared.metrics.solve.observe(watch.elapsed().as_secs_f64());
            self.running.charge_work(watch.elapsed());
            self.session.lease.renew();
            if let Some(mut frame) = solved.frame {
                frame.header.queue_ms = ms_of(queued);
                frame.header.solve_ms = ms_of(watch.elapsed());
                self.outbox.send_frame(frame);
            }
        }
        summary.ms = begun.elapsed().as_secs_f64() * 1e3;
        Ok(Some(summary))
    }

    /// What it means that a frame could not be solved.
    fn unsolved(&self, error: engine::Error, watch: &WorkWatch) -> Result<Option<AnimationSummary>, Error> {
        if error != engine::Error::Cancelled {
            return Err(error.into());
        }
        self.manager.shared.metrics.cancelled.inc();
        if self.session.cancel.cancelled() {
            return Err(self.session.why());
        }
        if watch.abandoned() {
            return Ok(None);
        }
        let limit = watch.limit().as_millis();
        let text = format!("a frame took longer than the {limit} ms that are allowed");
        Err(Error::new(ErrorCode::DeadlineExceeded, text))
    }
}

impl FrameSolver {
    /// Solves and measures the frame at a cursor.
    fn solve_next(
        &self,
        mut cursor: FrameCursor,
        mut sums: FrameSums,
        watch: &WorkWatch,
        pool: &Pool,
    ) -> Result<SolvedFrame, engine::Error> {
        let animation = &self.prepared.animation;
        let Some(mut frame) = animation.solve_next(&mut cursor, &Exec::new(pool, watch))? else {
            return Ok(SolvedFrame {
                cursor,
                sums,
                frame: None,
                cycles: 0,
            });
        };
        let mut quality = animation.quality(&frame.positions, pool);
        frame.quality.tell_crossings(&mut quality);
        sums.add(frame.index, &quality);
        let digest = digest(&frame.positions);
        match self.root {
            RootMotion::Apart => {}
            RootMotion::Baked => frame.bake_root(),
            RootMotion::Dropped => frame.root = RigidMotion::IDENTITY,
        }
        let narrow = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let animated = pb::Animated {
            index: narrow(frame.index),
            count: narrow(animation.times().count),
            time: frame.seconds,
            root_translation: frame.root.place(DVec3::ZERO).to_array().to_vec(),
            root_rotation: frame.root.rotation.to_array().to_vec(),
            digest,
            cycles: narrow(frame.cycles),
            ..Default::default()
        };
        let shading = (self.prepared.shader.as_ref()).map(|shader| Arc::new(shader.shade(&frame.positions)));
        let seq = frame.index as u64 + 1;
        let mut sent = (self.frames).frame(seq, self.output, Arc::new(frame.positions), shading);
        sent.root = Some(frame.root);
        sent.header = pb::Frame {
            r#final: true,
            residual: frame.residual,
            max_error: frame.max_error,
            quality: Some(quality_message(&quality)),
            animated: Some(animated),
            ..sent.header
        };
        Ok(SolvedFrame {
            cursor,
            sums,
            frame: Some(sent),
            cycles: frame.cycles,
        })
    }
}

/// One animation under way, until it is dropped.
#[derive(Debug)]
pub(crate) struct RunningAnimation {
    session: Arc<OpenSession>,
    _counted: GaugeUnit,
    _place: OwnedSemaphorePermit,
    of_tenant: TenantStream,
}

impl RunningAnimation {
    /// Counts one more; `place` is the one among all of the server's, `of_tenant` the one among the tenant's streams.
    pub fn on_session(
        session: &Arc<OpenSession>,
        place: OwnedSemaphorePermit,
        of_tenant: TenantStream,
        metrics: &Metrics,
    ) -> Self {
        session.animations.count_one_more();
        Self {
            session: Arc::clone(session),
            _counted: GaugeUnit::add_to(&metrics.animations),
            _place: place,
            of_tenant,
        }
    }

    /// Counts work that was done for it.
    pub fn charge_work(&self, time: Duration) {
        self.of_tenant.charge_work(time);
    }
}

impl Drop for RunningAnimation {
    fn drop(&mut self) {
        self.session.animations.count_one_less();
        self.session.lease.renew();
        self.session.wake.notify_one();
    }
}

/// What a vertex of a frame costs: its place, and what the written model has of it.
const VERTEX_BYTES: u64 = 48;

/// Frames in memory.
#[derive(Default)]
struct FramesInMemory {
    roots: Vec<RigidMotion>,
    shapes: Vec<Vec<Vec3>>,
}

impl FrameSource for FramesInMemory {
    type Failure = engine::Error;

    fn count(&self) -> usize {
        self.shapes.len()
    }

    fn root(&self, frame: usize) -> RigidMotion {
        self.roots[frame]
    }

    fn positions(&mut self, frame: usize) -> Result<Vec<Vec3>, engine::Error> {
        Ok(self.shapes[frame].clone())
    }
}

impl FramesInMemory {
    fn push(&mut self, frame: &Frame) {
        self.roots.push(frame.root.unwrap_or(RigidMotion::IDENTITY));
        self.shapes.push(frame.positions.iter().map(|p| p.as_vec3()).collect());
    }
}

/// Takes the frames of an animation, and writes a model that plays them.
pub(crate) async fn gather_clip(
    shared: &SharedResources,
    account: &Arc<TenantAccount>,
    owner: &WorkOwner,
    mut output: AnimationReader,
    form: PlayedForm,
    root: RootMotion,
) -> Result<AnimatedModel, Error> {
    let mut frames = FramesInMemory::default();
    let mut memory = None;
    let mut summary = loop {
        match output.next_answer().await {
            Some(Ok(AnimationAnswer::Stage { .. })) => {}
            Some(Ok(AnimationAnswer::Frame(frame))) => {
                if memory.is_none() {
                    memory = Some(reserve_frames(shared, account, output.prepared().as_deref())?);
                }
                frames.push(&frame);
            }
            Some(Ok(AnimationAnswer::Summary(summary))) => break *summary,
            Some(Err(error)) => return Err(error),
            None => return Err(Error::new(ErrorCode::Internal, "an animation ended without a result")),
        }
    };
    let gone = || Error::new(ErrorCode::Internal, "an animation has frames and was never prepared");
    let prepared = output.prepared().ok_or_else(gone)?;
    let guard = CancelOnDrop::default();
    let flags = vec![Arc::clone(&guard.0), Arc::clone(&shared.abort_flag)];
    let watch = Arc::new(WorkWatch::new(flags, shared.config.build));
    let inside = Arc::clone(&watch);
    let has_root = root == RootMotion::Apart;
    let slot = shared.compute.slot_for_frame(owner).await?;
    let span = WorkSpan::new(WorkKind::Clip, "", &Span::current());
    let written = slot.run(span, move |pool| {
        let exec = Exec::new(pool, &*inside);
        let animation = &prepared.animation;
        animation.write_clip(form, has_root, &mut frames, &exec)
    });
    let written = written.await.map_err(Error::from)?.map_err(|error| match error {
        engine::Error::Cancelled if !watch.abandoned() => {
            let limit = watch.limit().as_millis();
            let text = format!("writing the animation took longer than the {limit} ms that are allowed");
            Error::new(ErrorCode::DeadlineExceeded, text)
        }
        error => error.into(),
    })?;
    drop(memory);
    summary.warnings.extend(written.error.map(|error| error.message));
    Ok(AnimatedModel {
        model: written.files.main.into(),
        summary,
    })
}

/// The bytes that all frames will hold, of what all sessions together may.
fn reserve_frames(
    shared: &SharedResources,
    account: &Arc<TenantAccount>,
    prepared: Option<&PreparedAnimation>,
) -> Result<MemoryReservation, Error> {
    let (frames, vertices) = prepared.map_or((0, 0), |p| (p.animation.range().len(), p.animation.model().1.len()));
    if prepared.is_some_and(|p| p.animation.is_edited()) {
        let text =
            "edits have changed the model since it was read, and a GLB is made of the model as it was; ask for frames";
        return Err(Error::new(ErrorCode::FailedPrecondition, text));
    }
    let bytes = (frames as u64)
        .saturating_mul(vertices as u64)
        .saturating_mul(VERTEX_BYTES);
    let total = shared.ledger.total();
    if bytes > total {
        let text =
            format!("the animation as one model would need {bytes} bytes of memory, at most {total} are allowed");
        return Err(Error::new(ErrorCode::TooLarge, text));
    }
    let reserved = (shared.ledger).reserve(MemoryUse::Sessions, Some(account), bytes, bytes);
    reserved.map_err(|shortage| {
        let text = format!("the animation as one model would need {bytes} bytes of memory, and {shortage}");
        count_refusal(shared, no_place(text))
    })
}
