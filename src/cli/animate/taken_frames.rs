//! What takes the frames of an animation as they are solved, and what it is told of them all.

use crate::asset::{FileSet, Primitive};
use crate::cli::failure::CliFailure;
use crate::cli::output_files::OutputPermission;
use crate::engine::{AnimatedFrame, Animation, Deformer, FrameTimes};
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
    /// The clip's name.
    pub(super) clip: &'a str,
    /// Its number in the model, where the clip is of the model's own skin.
    pub(super) own: Option<usize>,
    pub(super) times: FrameTimes,
    pub(super) range: Range<usize>,
    /// What tells it from every other: lines of a name and a value.
    pub(super) identity: &'a str,
    pub(super) permission: OutputPermission,
    pub(super) exec: Exec<'a>,
}

impl PlayedAnimation<'_> {
    /// When a frame is, in seconds from the first.
    pub(super) fn seconds(&self, frame: usize) -> f64 {
        (frame - self.range.start) as f64 / self.times.rate
    }

    /// The vertices that are played; the others go on as the model's own clip moves them.
    pub(super) fn played_vertices(&self) -> Vec<usize> {
        let rests = |p: &&Primitive| self.own.is_some() && p.is_passenger;
        let mut is_played = vec![true; self.deformer.rest().len()];
        for primitive in self.deformer.geometry().primitives.iter().filter(rests) {
            is_played[primitive.vertices()].fill(false);
        }
        (0..is_played.len()).filter(|vertex| is_played[*vertex]).collect()
    }
}

/// Takes frames.
pub(super) trait FrameTaker {
    /// The frames that are still to be solved.
    fn missing(&self) -> Range<usize>;

    /// Takes the next frame.
    fn take(&mut self, frame: &AnimatedFrame, told: &pb::animation_report::FrameReport) -> Result<(), CliFailure>;

    /// Ends the output after the last frame, and tells of it.
    fn finish(&mut self, report: &mut pb::AnimationReport, animation: &Animation) -> Result<(), CliFailure>;
}

/// Takes frames that are only measured.
pub(super) struct MeasuredFrames(pub(super) Range<usize>);

impl FrameTaker for MeasuredFrames {
    fn missing(&self) -> Range<usize> {
        self.0.clone()
    }

    fn take(&mut self, _: &AnimatedFrame, _: &pb::animation_report::FrameReport) -> Result<(), CliFailure> {
        Ok(())
    }

    fn finish(&mut self, _: &mut pb::AnimationReport, _: &Animation) -> Result<(), CliFailure> {
        Ok(())
    }
}
