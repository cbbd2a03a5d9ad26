//! The frames of an animation, solved and reported one by one.

use crate::cli::failure::CliFailure;
use crate::engine::{AnimatedFrame, Animation, FrameSums, QualityReport, digest};
use crate::exec::Exec;
use crate::wire::{animation_totals, held_nodes_message, pb};
use std::ops::Range;

/// Solves frames of an animation. Passes each frame with its report to `take` once it is solved, in any order. Returns
/// the report of all. `millis` is a clock.
///
/// # Errors
/// Those of [`Animation::solve`] and of `take`.
pub(super) fn play(
    animation: &Animation,
    ranges: &[Range<usize>],
    bakes_root: bool,
    exec: &Exec<'_>,
    millis: &(dyn Fn() -> f64 + Sync),
    take: &mut dyn FnMut(&AnimatedFrame, &pb::animation_report::FrameReport) -> Result<(), CliFailure>,
) -> Result<pb::AnimationReport, CliFailure> {
    let mut report = pb::AnimationReport {
        warnings: animation.warnings(),
        scale: animation.driver().scale(),
        handles: held_nodes_message(animation.handle_facts()),
        ..Default::default()
    };
    let begun = millis();
    let mut refused = None;
    let mut take_solved = |mut frame: AnimatedFrame, ms: f64| {
        let measured = frame_report(&frame, ms);
        if bakes_root {
            frame.bake_root();
        }
        refused = take(&frame, &measured).err();
        report.frames.push(measured);
        refused.is_none()
    };
    let solved = animation.solve(ranges, exec.pool.threads(), millis, exec, &mut take_solved);
    if let Some(refused) = refused {
        return Err(refused);
    }
    solved?;
    report.frames.sort_by_key(|frame| frame.index);
    report.totals = Some(frame_totals(&report.frames, millis() - begun));
    Ok(report)
}

fn frame_report(frame: &AnimatedFrame, ms: f64) -> pb::animation_report::FrameReport {
    let quality = &frame.quality;
    pb::animation_report::FrameReport {
        index: u32::try_from(frame.index).unwrap_or(u32::MAX),
        time: frame.seconds,
        ms,
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

/// Sums over frames that took so many milliseconds together.
pub(super) fn frame_totals(frames: &[pb::animation_report::FrameReport], ms: f64) -> pb::animation_report::Totals {
    let mut sums = FrameSums::default();
    for frame in frames {
        sums.add(&QualityReport {
            volume_change: frame.volume_change,
            flipped_triangles: frame.flipped_triangles,
            max_stretch: frame.max_stretch,
            edge_rms: frame.edge_rms,
            ..Default::default()
        });
    }
    animation_totals(&sums, ms)
}
