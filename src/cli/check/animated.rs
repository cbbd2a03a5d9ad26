//! A case that is an animation, in process.

use crate::asset::{FileSet, Format, Model};
use crate::check::{AnimationCase, CaseResult};
use crate::engine::{Animation, Deformer, DeformerLimits, digest};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::progress::Silent;
use crate::session::SessionConfig;
use crate::wire::{self, RootMotion, animate_order, quality_message};

/// Runs an animation of a model. The shape before is the caller's to add.
///
/// # Errors
/// Why it cannot be run.
pub(super) fn animate_in_process(files: FileSet, animation: &AnimationCase, pool: &Pool) -> Result<CaseResult, String> {
    play_frames(files, animation, pool).map_err(|e| e.to_string())
}

fn play_frames(files: FileSet, animation: &AnimationCase, pool: &Pool) -> Result<CaseResult, wire::Error> {
    let exec = Exec::new(pool, &Silent);
    let limits = DeformerLimits::default();
    let usual = SessionConfig::default();
    let order = animate_order(&animation.options, usual.window, usual.clip_bytes)?;
    let model = Model::read(files, Format::from_name(&animation.create.format), &limits.model)?;
    let deformer = Deformer::of_model(model, &wire::open_options(&animation.create)?, &limits, &exec)?;
    let prepared = Animation::prepare(&deformer, &order.request, &usual.animation_limits(), &exec);
    let animation = prepared.map_err(|e| wire::of_rig(e.into()))?;
    let mut cursor = animation.cursor(animation.range().clone());
    let mut found = CaseResult::default();
    while cursor.next_index().is_some() {
        let Some(mut frame) = animation.solve_next(&mut cursor, &exec)? else {
            continue;
        };
        found.digest = digest(&frame.positions);
        found.frames.push(found.digest.clone());
        found.take_quality(&quality_message(&animation.quality(&frame.positions, pool)));
        if order.root == RootMotion::Baked {
            frame.bake_root();
        }
        found.positions = frame.positions;
    }
    Ok(found)
}
