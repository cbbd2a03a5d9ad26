//! All frames of an animation as one model that plays them.

use crate::engine::{self, FrameSource, PlayedForm};
use crate::exec::Exec;
use crate::motion::rig::RigidMotion;
use crate::session::animation::frame_outbox::AnimationReader;
use crate::session::animation::prepared_animation::PreparedAnimation;
use crate::session::answers::{AnimatedModel, AnimationAnswer};
use crate::session::capacity::memory_ledger::MemoryReservation;
use crate::session::capacity::memory_use::MemoryUse;
use crate::session::capacity::work_owner::WorkOwner;
use crate::session::capacity::work_span::{WorkKind, WorkSpan};
use crate::session::capacity::work_watch::{CancelOnDrop, WorkWatch};
use crate::session::error::{Error, ErrorCode};
use crate::session::quota::tenant_account::TenantAccount;
use crate::session::shared::SharedResources;
use crate::wire::RootMotion;
use crate::wire::frames::Frame;
use glam::Vec3;
use std::sync::Arc;
use tracing::Span;

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
pub(in crate::session) async fn gather_clip(
    (shared, account, owner): (&SharedResources, &Arc<TenantAccount>, &WorkOwner),
    mut output: AnimationReader,
    (form, root): (PlayedForm, RootMotion),
) -> Result<AnimatedModel, Error> {
    let mut frames = FramesInMemory::default();
    let mut memory = None;
    let mut summary = loop {
        match output.next_answer().await {
            Some(Ok(AnimationAnswer::Stage { .. })) => {}
            Some(Ok(AnimationAnswer::Frame(frame))) => {
                if memory.is_none() {
                    memory = Some(reserve_frames((shared, account), output.prepared().as_deref())?);
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
    (shared, account): (&SharedResources, &Arc<TenantAccount>),
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
        shared.metrics.refused.inc();
        let text = format!("the animation as one model would need {bytes} bytes of memory, and {shortage}");
        Error::exhausted(text, 5)
    })
}
