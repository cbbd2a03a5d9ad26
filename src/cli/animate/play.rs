//! The frames of an animation, solved, shown and reported one by one, and what takes them.

use crate::asset::{FileSet, Primitive};
use crate::cli::output_files::OutputPermission;
use crate::cli::terminal::{CliFailure, ComputeArgs, ProgressDisplay};
use crate::engine::{AnimatedFrame, Animation, Deformer, FrameSums, QualityReport, digest};
use crate::exec::Exec;
use crate::progress::{CancelFlag, Progress};
use crate::wire::{animation_totals, feet_message, held_nodes_message, pb};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

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
        feet: feet_message(animation.feet()),
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
    let mut counted = QualityReport::default();
    quality.tell_crossings(&mut counted);
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
        self_intersections: counted.self_intersections,
        new_self_intersections: counted.new_self_intersections,
    }
}

/// Sums over frames that took so many milliseconds together.
pub(super) fn frame_totals(frames: &[pb::animation_report::FrameReport], ms: f64) -> pb::animation_report::Totals {
    let mut sums = FrameSums::default();
    for frame in frames {
        let quality = QualityReport {
            volume_change: frame.volume_change,
            flipped_triangles: frame.flipped_triangles,
            max_stretch: frame.max_stretch,
            edge_rms: frame.edge_rms,
            self_intersections: frame.self_intersections,
            new_self_intersections: frame.new_self_intersections,
            ..Default::default()
        };
        sums.add(frame.index as usize, &quality);
    }
    animation_totals(&sums, ms)
}

/// The animation that frames are of.
pub(super) struct PlayedAnimation<'a> {
    pub(super) deformer: &'a Deformer,
    pub(super) animation: &'a Animation,
    /// The model's path and files, as they were read.
    pub(super) model: &'a Path,
    pub(super) files: &'a FileSet,
    /// What identifies it: lines of a name and a value.
    pub(super) identity: &'a str,
    pub(super) permission: OutputPermission,
    pub(super) exec: Exec<'a>,
}

impl PlayedAnimation<'_> {
    /// When a frame is, in seconds from the first.
    pub(super) fn seconds(&self, frame: usize) -> f64 {
        (frame - self.animation.range().start) as f64 / self.animation.times().rate
    }

    /// The vertices of what is solved; the others have no skin, or are coarser levels of detail.
    pub(super) fn solved_vertices(&self) -> Vec<usize> {
        let solved = self.deformer.geometry().primitives.iter().filter(|p| !p.is_passenger);
        solved.flat_map(Primitive::vertices).collect()
    }
}

/// Takes frames.
pub(super) trait FrameTaker {
    /// The frames that are still to be solved.
    fn missing(&self) -> Vec<Range<usize>>;

    /// Takes a frame, in whatever order they are solved.
    fn take(&mut self, frame: &AnimatedFrame, reported: &pb::animation_report::FrameReport) -> Result<(), CliFailure>;

    /// Ends before all frames are there; says what is kept, and how to continue.
    fn stop(&mut self) -> String;

    /// Ends the output after the last frame, and reports it.
    fn finish(&mut self, report: &mut pb::AnimationReport, exec: &Exec<'_>) -> Result<(), CliFailure>;
}

/// Takes frames that are only measured.
pub(super) struct MeasuredFrames(pub(super) Range<usize>);

impl FrameTaker for MeasuredFrames {
    fn missing(&self) -> Vec<Range<usize>> {
        vec![self.0.clone()]
    }

    fn take(&mut self, _: &AnimatedFrame, _: &pb::animation_report::FrameReport) -> Result<(), CliFailure> {
        Ok(())
    }

    fn stop(&mut self) -> String {
        "stopped before the last frame; without --output nothing is kept".into()
    }

    fn finish(&mut self, _: &mut pb::AnimationReport, _: &Exec<'_>) -> Result<(), CliFailure> {
        Ok(())
    }
}

/// The frames of a range that are not there.
pub(super) fn missing_ranges(range: Range<usize>, is_there: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut missing: Vec<Range<usize>> = Vec::new();
    for frame in range.filter(|frame| !is_there(*frame)) {
        match missing.last_mut() {
            Some(last) if last.end == frame => last.end += 1,
            _ => missing.push(frame..frame + 1),
        }
    }
    missing
}

/// What is said of frames that are kept when an animation is stopped, and how many there should be.
pub(super) fn kept_frames([kept, frames]: [usize; 2], place: &Path) -> String {
    match kept {
        0 => "stopped before the first frame; nothing is kept".into(),
        _ => format!(
            "stopped: {kept} of {frames} frames are kept in {}; the same command with --resume continues",
            place.display()
        ),
    }
}

/// Parts of a whole bar.
const WHOLE: u64 = 10_000;

/// Watches an animation: shows solved frames, frames a second and the time left, and gives the work up when its flag is raised.
pub(super) struct FramesBar {
    display: ProgressDisplay,
    stop: Arc<CancelFlag>,
    begun: Instant,
    solved: AtomicUsize,
    frames: usize,
}

impl FramesBar {
    /// Starts a bar over so many frames; a quiet one draws nothing.
    pub(super) fn new(args: &ComputeArgs, quiet: bool, frames: usize, stop: Arc<CancelFlag>) -> Self {
        Self {
            display: args.show_parts(quiet, WHOLE),
            stop,
            begun: Instant::now(),
            solved: AtomicUsize::new(0),
            frames,
        }
    }

    /// One more frame is solved.
    pub(super) fn step(&self) {
        self.solved.fetch_add(1, Ordering::Relaxed);
    }

    /// Takes the bar off the terminal.
    pub(super) fn finish(&self) {
        self.display.finish();
    }
}

impl Progress for FramesBar {
    fn cancelled(&self) -> bool {
        self.stop.cancelled()
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        if stage != "frames" || self.display.is_hidden() {
            return;
        }
        let fraction = f64::from(fraction).clamp(0.0, 1.0);
        let solved = self.solved.load(Ordering::Relaxed);
        let text = bar_text([solved, self.frames], self.begun.elapsed(), fraction);
        self.display.show(stage, (fraction * WHOLE as f64) as u64, text);
    }
}

/// What stands beside a bar. The time left follows from the share of the work that is done, frames that only lead to others
/// included, so that it is right before the first frame is there too.
fn bar_text([solved, frames]: [usize; 2], elapsed: Duration, fraction: f64) -> String {
    let mut text = format!("{solved} of {frames} frames");
    if solved > 0 {
        text += &format!(", {:.1}/s", solved as f64 / elapsed.as_secs_f64().max(1e-3));
    }
    if fraction > 0.0 {
        let left = (elapsed.as_secs_f64() * (1.0 - fraction) / fraction).round() as u64;
        text += &match [left / 3600, left / 60 % 60, left % 60] {
            [0, 0, seconds] => format!(", {seconds}s left"),
            [0, minutes, seconds] => format!(", {minutes}m {seconds}s left"),
            [hours, minutes, _] => format!(", {hours}h {minutes}m left"),
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_frames_are_ranges() {
        let missing = |range: Range<usize>, there: &[usize]| missing_ranges(range, |frame| there.contains(&frame));
        let whole = 5..9;
        assert!(missing(5..5, &[]).is_empty() && missing(5..7, &[5, 6]).is_empty());
        assert_eq!(missing(whole.clone(), &[]), [whole]);
        assert_eq!(missing(5..12, &[5, 8, 9]), [6..8, 10..12]);
    }

    #[test]
    fn the_time_left_follows_from_the_work_that_is_done() {
        let text = |solved: usize, seconds: u64, fraction: f64| {
            bar_text([solved, 300], Duration::from_secs(seconds), fraction)
        };
        assert_eq!(text(0, 0, 0.0), "0 of 300 frames");
        assert_eq!(text(0, 2, 0.1), "0 of 300 frames, 18s left");
        assert_eq!(text(90, 10, 0.25), "90 of 300 frames, 9.0/s, 30s left");
        assert_eq!(text(1, 10, 0.1), "1 of 300 frames, 0.1/s, 1m 30s left");
        assert_eq!(text(1, 100, 0.01), "1 of 300 frames, 0.0/s, 2h 45m left");
    }
}
