//! The consumers of an animation's frames, and what they know of the animation.

use crate::asset::{FileSet, Primitive};
use crate::cli::failure::CliFailure;
use crate::cli::output_files::OutputPermission;
use crate::engine::{AnimatedFrame, Animation, Deformer};
use crate::exec::Exec;
use crate::wire::pb;
use std::ops::Range;
use std::path::Path;

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
    fn take(&mut self, frame: &AnimatedFrame, told: &pb::animation_report::FrameReport) -> Result<(), CliFailure>;

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
}
