//! Animations run in process: a model, a rig and a clip to frames and their report.

use crate::asset::FileSet;
use crate::engine::{
    AnimatedFrame, Animation, AnimationSettings, Deformer, DeformerLimits, FrameTimes, OpenOptions, digest,
};
use crate::exec::Exec;
use crate::motion::rig::{MotionRig, RigDriver};
use crate::wire::{Error, pb};
use std::ops::Range;

/// A clip on a rig, to be played by a model.
pub struct AnimationOrder {
    /// The rig.
    pub rig: MotionRig,
    /// The clip on it.
    pub driver: RigDriver,
    /// When the frames are.
    pub times: FrameTimes,
    /// Which of them are wanted.
    pub range: Range<usize>,
    /// How they are solved.
    pub settings: AnimationSettings,
    /// Blocks that are solved at the same time.
    pub blocks_at_once: usize,
    /// Whether the root's motion goes into the positions.
    pub bakes_root: bool,
}

/// Opens a model and prepares an animation of it.
///
/// # Errors
/// Those of [`Deformer::open`] and [`Deformer::animation`].
pub fn prepare(
    files: FileSet,
    options: &OpenOptions,
    order: &AnimationOrder,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
) -> Result<(Deformer, Animation), Error> {
    let deformer = Deformer::open(files, options, limits, exec)?;
    let (rig, driver) = (order.rig.clone(), order.driver.clone());
    let animation = deformer.animation(rig, driver, order.times, &order.settings, exec)?;
    Ok((deformer, animation))
}

/// Solves the frames of an order, gives each to `take` and tells of it. `millis` is a clock.
///
/// # Errors
/// Those of [`Animation::solve`], and what `take` refuses with.
pub fn play<E: From<Error>>(
    deformer: &Deformer,
    animation: &Animation,
    order: &AnimationOrder,
    exec: &Exec<'_>,
    millis: &dyn Fn() -> f64,
    take: &mut dyn FnMut(&AnimatedFrame) -> Result<(), E>,
) -> Result<pb::AnimationReport, E> {
    let mut report = pb::AnimationReport {
        warnings: animation.driver().warnings().to_vec(),
        scale: animation.driver().scale(),
        handles: (animation.handle_facts().iter())
            .map(|held| pb::animation_report::HeldNodes {
                name: held.name.clone(),
                nodes: u32::try_from(held.nodes).unwrap_or(u32::MAX),
                widened: held.widened,
            })
            .collect(),
        ..Default::default()
    };
    let begun = millis();
    let mut last = begun;
    let mut refused = None;
    let solved = animation.solve(order.range.clone(), order.blocks_at_once, exec, &mut |mut frame| {
        let mut told = frame_report(deformer, &frame, exec);
        if order.bakes_root {
            frame.bake_root();
        }
        refused = take(&frame).err();
        let now = millis();
        told.ms = now - last;
        last = now;
        report.frames.push(told);
        refused.is_none()
    });
    if let Some(refused) = refused {
        return Err(refused);
    }
    solved.map_err(Error::from)?;
    report.totals = Some(totals(&report.frames, last - begun));
    Ok(report)
}

fn frame_report(deformer: &Deformer, frame: &AnimatedFrame, exec: &Exec<'_>) -> pb::animation_report::FrameReport {
    let quality = deformer.quality(&frame.positions, exec.pool);
    pb::animation_report::FrameReport {
        index: u32::try_from(frame.index).unwrap_or(u32::MAX),
        time: frame.seconds,
        ms: 0.0,
        cycles: u32::try_from(frame.cycles).unwrap_or(u32::MAX),
        volume_change: quality.volume_change,
        flipped_triangles: quality.flipped_triangles,
        max_stretch: quality.max_stretch,
        edge_rms: quality.edge_rms,
        digest: digest(&frame.positions),
        root_translation: (frame.root.to - frame.root.from).to_array().to_vec(),
        root_rotation: frame.root.rotation.to_array().to_vec(),
    }
}

fn totals(frames: &[pb::animation_report::FrameReport], ms: f64) -> pb::animation_report::Totals {
    let count = frames.len().max(1) as f64;
    let mean = |of: &dyn Fn(&pb::animation_report::FrameReport) -> f64| frames.iter().map(of).sum::<f64>() / count;
    let worst = frames.iter().map(|f| f.volume_change);
    pb::animation_report::Totals {
        frames: u32::try_from(frames.len()).unwrap_or(u32::MAX),
        ms,
        frames_per_second: if ms > 0.0 { 1e3 * frames.len() as f64 / ms } else { 0.0 },
        volume_change_mean: mean(&|f| f.volume_change),
        volume_change_worst: worst.fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a }),
        flipped_triangles_mean: mean(&|f| f64::from(f.flipped_triangles)),
        flipped_triangles_worst: frames.iter().map(|f| f.flipped_triangles).max().unwrap_or(0),
        max_stretch: frames.iter().map(|f| f.max_stretch).fold(0.0, f64::max),
        edge_rms_mean: mean(&|f| f.edge_rms),
    }
}
