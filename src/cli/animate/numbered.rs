//! Frames as numbered models in a folder, each written as it comes.
//!
//! While frames are missing, a file beside them says what they are of. Models are written beside their places and renamed, so
//! those that are there are whole.

use super::play::{FrameTaker, PlayedAnimation, kept_frames, missing_ranges};
use crate::asset::Format;
use crate::cli::input_files::read_file;
use crate::cli::terminal::CliFailure;
use crate::engine::AnimatedFrame;
use crate::exec::Exec;
use crate::wire::pb;
use std::fs;
use std::ops::Range;
use std::path::PathBuf;

/// What says what the frames of a folder are of.
const MARK: &str = "frames.part";

/// A folder of numbered models.
pub(super) struct NumberedFrames<'a> {
    folder: PathBuf,
    format: Format,
    played: PlayedAnimation<'a>,
    missing: Vec<Range<usize>>,
    kept: usize,
    has_begun: bool,
}

impl<'a> NumberedFrames<'a> {
    /// Checks what is in the folder.
    pub(super) fn begin(
        folder: PathBuf,
        format: Format,
        resumes: bool,
        played: PlayedAnimation<'a>,
    ) -> Result<Self, CliFailure> {
        let missing = vec![played.animation.range().clone()];
        let mut frames = Self {
            folder,
            format,
            played,
            missing,
            kept: 0,
            has_begun: false,
        };
        let mark = frames.folder.join(MARK);
        let is_there = |frame: &usize| frames.path(*frame).is_file();
        if resumes && !frames.played.permission.force && frames.played.animation.range().clone().any(|f| is_there(&f)) {
            let refuse = |problem: &str| {
                let folder = frames.folder.display();
                Err(CliFailure::Input(format!("cannot continue in {folder}: {problem}")))
            };
            match read_file(&mark) {
                Err(_) => return refuse("there is no frames.part that says what its frames are of"),
                Ok(text) => {
                    let text = String::from_utf8_lossy(&text);
                    if let Some(other) = first_difference(&text, frames.played.identity) {
                        return refuse(&format!("its frames are of another animation ({other})"));
                    }
                }
            }
            let missing = missing_ranges(frames.played.animation.range().clone(), |frame| is_there(&frame));
            frames.kept =
                frames.played.animation.range().len() - missing.iter().map(ExactSizeIterator::len).sum::<usize>();
            frames.missing = missing;
            return Ok(frames);
        }
        for frame in frames.played.animation.range().clone() {
            frames.played.permission.check_target(&frames.path(frame))?;
        }
        Ok(frames)
    }

    fn path(&self, frame: usize) -> PathBuf {
        self.folder.join(format!("frame_{frame:05}.{}", self.format))
    }
}

impl FrameTaker for NumberedFrames<'_> {
    fn missing(&self) -> Vec<Range<usize>> {
        self.missing.clone()
    }

    fn take(&mut self, frame: &AnimatedFrame, _: &pb::animation_report::FrameReport) -> Result<(), CliFailure> {
        let PlayedAnimation {
            deformer,
            model,
            files,
            permission,
            identity,
            exec,
            ..
        } = &self.played;
        let path = self.path(frame.index);
        if !self.has_begun {
            let mark = self.folder.join(MARK);
            let mut allowed = *permission;
            allowed.force = true;
            allowed.write_file(&mark, identity.as_bytes())?;
            self.has_begun = true;
        }
        let written = deformer.write(&frame.positions, self.format, exec)?;
        permission.write_model(&path, &written, model, files)?;
        self.kept += 1;
        Ok(())
    }

    fn stop(&mut self) -> String {
        kept_frames([self.kept, self.played.animation.range().len()], &self.folder)
    }

    fn finish(&mut self, report: &mut pb::AnimationReport, _: &Exec<'_>) -> Result<(), CliFailure> {
        let before = self.kept - report.frames.len();
        if before > 0 {
            report.warnings.push(format!(
                "{before} frames were there already; the report does not list them"
            ));
        }
        let frames = self.played.animation.range().clone();
        report.output = frames.map(|f| self.path(f).display().to_string()).collect();
        // Without it, the folder is complete.
        let _ = fs::remove_file(self.folder.join(MARK));
        Ok(())
    }
}

/// The first line in which two texts differ, as both say it.
pub(super) fn first_difference(there: &str, wanted: &str) -> Option<String> {
    if there == wanted {
        return None;
    }
    let mut pairs = there.lines().zip(wanted.lines());
    let lines = pairs.find(|(a, b)| a != b);
    Some(lines.map_or_else(|| "of another kind".into(), |(a, b)| format!("{a}, not {b}")))
}
