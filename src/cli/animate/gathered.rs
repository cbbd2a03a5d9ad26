//! Frames that become one file: kept in a partial file until the last one is there.

use super::frames_file::FramesFile;
use super::taken_frames::{FrameTaker, PlayedAnimation, kept_frames, missing_ranges};
use crate::asset::{NodePlace, UsdClip, VertexCache};
use crate::cli::failure::CliFailure;
use crate::engine::{AnimatedFrame, FrameSource, PlayedForm, WrittenError, node_place};
use crate::exec::Exec;
use crate::motion::rig::RigidMotion;
use crate::wire::pb::animation_report::FrameReport;
use crate::wire::{Error, pb};
use glam::Vec3;
use std::io::{BufWriter, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// What frames in one file become.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum GatheredKind {
    /// A point cache.
    Cache(VertexCache),
    /// USD text.
    Usd,
    /// A GLB that plays the frames.
    Glb(PlayedForm),
}

/// An output of one file.
pub(super) struct GatheredFrames<'a> {
    path: PathBuf,
    kind: GatheredKind,
    has_root: bool,
    played: PlayedAnimation<'a>,
    frames: FramesFile,
    /// Reports of the frames that an earlier run solved.
    before: Vec<FrameReport>,
}

impl<'a> GatheredFrames<'a> {
    /// Begins a partial file, or goes on with the one that is there.
    pub(super) fn begin(
        path: &Path,
        kind: GatheredKind,
        (has_root, resumes): (bool, bool),
        played: PlayedAnimation<'a>,
    ) -> Result<Self, CliFailure> {
        if kind == GatheredKind::Usd {
            // What cannot be written is refused before anything is solved.
            played.deformer.model().for_usd().map_err(Error::from)?;
        }
        let (part, permission) = (FramesFile::path_for(path), played.permission);
        let vertices = played.deformer.rest().len();
        // A link that leads nowhere is there too.
        let is_there = part.symlink_metadata().is_ok();
        let frames = if resumes && is_there {
            FramesFile::open(&part, played.identity, vertices, played.animation.range().clone())?
        } else {
            if is_there && !permission.force {
                let problem =
                    "it holds frames of a run that was stopped; --resume continues with them, --force starts over";
                return Err(CliFailure::Input(format!("cannot write {}: {problem}", part.display())));
            }
            permission.make_folder_of(&part)?;
            FramesFile::create(&part, played.identity, vertices, played.animation.range().clone())?
        };
        Ok(Self {
            path: path.to_owned(),
            kind,
            has_root,
            before: frames.frames.values().map(|frame| frame.told.clone()).collect(),
            played,
            frames,
        })
    }

    fn write_cache(&mut self, cache: VertexCache) -> Result<(), CliFailure> {
        let played = &self.played;
        let seconds: Vec<f64> = played.animation.range().clone().map(|f| played.seconds(f)).collect();
        let vertices = played.deformer.rest().len() as u32;
        let frames = &mut self.frames;
        played
            .permission
            .write_streamed(&self.path, &mut |file: &mut dyn Write| {
                file.write_all(&cache.header(vertices, &seconds))?;
                for frame in 0..seconds.len() {
                    file.write_all(&cache.frame(&frames.positions(frame)?))?;
                }
                Ok(())
            })
    }

    /// Writes a GLB that plays the frames; returns its error, if measured.
    fn write_glb(&mut self, form: PlayedForm, exec: &Exec<'_>) -> Result<Option<WrittenError>, CliFailure> {
        let played = &self.played;
        let mut frames = FramesOfRange {
            file: &mut self.frames,
            count: played.animation.range().len(),
        };
        let written = played.animation.write_clip(form, self.has_root, &mut frames, exec)?;
        played
            .permission
            .write_model(&self.path, &written.files, played.model, played.files)?;
        Ok(written.error)
    }
}

/// The first frames of a partial file.
struct FramesOfRange<'a> {
    file: &'a mut FramesFile,
    count: usize,
}

impl FrameSource for FramesOfRange<'_> {
    type Failure = CliFailure;

    fn count(&self) -> usize {
        self.count
    }

    fn root(&self, frame: usize) -> RigidMotion {
        self.file.frames[&frame].root
    }

    fn positions(&mut self, frame: usize) -> Result<Vec<Vec3>, CliFailure> {
        self.file.read_positions(frame)
    }
}

impl GatheredFrames<'_> {
    fn write_usd(&mut self) -> Result<(), CliFailure> {
        let played = &self.played;
        let usd = played.deformer.model().for_usd().map_err(Error::from)?;
        let count = played.animation.range().len();
        let roots = self.frames.frames.values();
        let places: Vec<NodePlace> = roots.map(|frame| node_place(&frame.root)).collect();
        let moves = self.has_root && places.iter().any(|place| *place != NodePlace::IDENTITY);
        let clip = UsdClip {
            name: match played.animation.clip_name() {
                "" => "clip",
                name => name,
            },
            rate: played.animation.times().rate,
            frames: count,
            root: moves.then_some(&places),
        };
        let frames = &mut self.frames;
        played
            .permission
            .write_streamed(&self.path, &mut |file: &mut dyn Write| {
                let mut buffered = BufWriter::new(file);
                usd.write(
                    &clip,
                    &mut |frame, range| frames.positions_of(frame, range),
                    &mut buffered,
                )?;
                buffered.flush()
            })
    }
}

impl FrameTaker for GatheredFrames<'_> {
    fn missing(&self) -> Vec<Range<usize>> {
        let start = self.played.animation.range().start;
        missing_ranges(self.played.animation.range().clone(), |frame| {
            self.frames.frames.contains_key(&(frame - start))
        })
    }

    fn take(&mut self, frame: &AnimatedFrame, told: &FrameReport) -> Result<(), CliFailure> {
        self.frames.push(frame, told)
    }

    fn stop(&mut self) -> String {
        let (kept, part) = (self.frames.frames.len(), FramesFile::path_for(&self.path));
        if kept == 0 {
            self.frames.remove();
        }
        kept_frames([kept, self.played.animation.range().len()], &part)
    }

    fn finish(&mut self, report: &mut pb::AnimationReport, exec: &Exec<'_>) -> Result<(), CliFailure> {
        match self.kind {
            GatheredKind::Cache(cache) => self.write_cache(cache)?,
            GatheredKind::Usd => self.write_usd()?,
            GatheredKind::Glb(form) => {
                if let Some(error) = self.write_glb(form, exec)? {
                    report.warnings.push(error.message);
                    report.written_error = Some(pb::animation_report::WrittenError {
                        rms_percent: error.rms_percent,
                        max_percent: error.max_percent,
                        parts: u32::try_from(error.parts).unwrap_or(u32::MAX),
                    });
                }
            }
        }
        report.frames.append(&mut self.before);
        report.frames.sort_by_key(|frame| frame.index);
        report.output.push(self.path.display().to_string());
        self.frames.remove();
        Ok(())
    }
}
