//! Frames that become one file: kept in a partial file until the last one is there.

use super::numbered::first_difference;
use super::play::{FrameTaker, PlayedAnimation, kept_frames, missing_ranges};
use crate::asset::{NodePlace, UsdClip, VertexCache};
use crate::cli::input_files::open_regular_file;
use crate::cli::terminal::CliFailure;
use crate::engine::{AnimatedFrame, FrameSource, PlayedForm, WrittenError, node_place};
use crate::exec::Exec;
use crate::motion::rig::RigidMotion;
use crate::wire::pb::animation_report::FrameReport;
use crate::wire::{Error, pb};
use flate2::Crc;
use glam::{DQuat, DVec3, Vec3};
use prost::Message as _;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Read as _, Seek as _, SeekFrom, Write};
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
        has_root: bool,
        resumes: bool,
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
            before: frames.frames.values().map(|frame| frame.reported.clone()).collect(),
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

    fn take(&mut self, frame: &AnimatedFrame, reported: &FrameReport) -> Result<(), CliFailure> {
        self.frames.push(frame, reported)
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

const MARK: &[u8; 16] = b"pliant frames 2\n";
/// Bytes of what a root does.
const ROOT: usize = 80;
/// Most bytes of a report.
const LONGEST: u32 = 1 << 16;

/// A frame of the file.
pub(super) struct StoredFrame {
    /// Where its positions begin.
    at: u64,
    pub(super) root: RigidMotion,
    pub(super) reported: FrameReport,
}

/// The partial file of an output.
pub(super) struct FramesFile {
    path: PathBuf,
    file: File,
    vertices: usize,
    end: u64,
    /// The frames that the animation has.
    range: Range<usize>,
    /// Those so far, by how many the animation has before them.
    pub(super) frames: BTreeMap<usize, StoredFrame>,
}

impl FramesFile {
    /// Where the partial file of an output lies.
    pub(super) fn path_for(output: &Path) -> PathBuf {
        let mut name = output.file_name().unwrap_or_default().to_os_string();
        name.push(".part");
        output.with_file_name(name)
    }

    /// Begins a file, in place of one that is there.
    pub(super) fn create(
        path: &Path,
        identity: &str,
        vertices: usize,
        range: Range<usize>,
    ) -> Result<Self, CliFailure> {
        let make = || {
            // Removed first, then made again: through a link that lies there, another file would be written over.
            match fs::remove_file(path) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
                _ => {}
            }
            let mut open = OpenOptions::new();
            let mut file = open.read(true).write(true).create_new(true).open(path)?;
            let mut head = MARK.to_vec();
            head.extend((identity.len() as u32).to_le_bytes());
            head.extend(identity.as_bytes());
            file.write_all(&head)?;
            Ok((file, head.len() as u64))
        };
        let (file, end) = make().map_err(|e| failure("write", path, &e))?;
        Ok(Self {
            path: path.to_owned(),
            file,
            vertices,
            end,
            range,
            frames: BTreeMap::new(),
        })
    }

    /// Opens a file that is there, and cuts off what is not whole.
    pub(super) fn open(path: &Path, identity: &str, vertices: usize, range: Range<usize>) -> Result<Self, CliFailure> {
        let refuse = |e: &io::Error| failure("read", path, e);
        let mut file = open_regular_file(path, OpenOptions::new().read(true).write(true))?;
        let mut head = vec![0; MARK.len() + 4];
        let other = |problem: &str| {
            let place = path.display();
            CliFailure::Input(format!("cannot continue {place}: {problem}"))
        };
        if file.read_exact(&mut head).is_err() || !head.starts_with(MARK) {
            return Err(other("it holds no frames of pliant"));
        }
        let length = head.last_chunk::<4>().map_or(0, |b| u32::from_le_bytes(*b));
        let mut text = vec![0; length.min(LONGEST) as usize];
        let text = file.read_exact(&mut text).map(|()| String::from_utf8_lossy(&text));
        let text = text.map_err(|e| refuse(&e))?;
        if let Some(difference) = first_difference(&text, identity) {
            return Err(other(&format!("it is of another animation ({difference})")));
        }
        let mut frames = Self {
            path: path.to_owned(),
            end: head.len() as u64 + text.len() as u64,
            file,
            vertices,
            range,
            frames: BTreeMap::new(),
        };
        frames.find_frames().map_err(|e| refuse(&e))?;
        Ok(frames)
    }

    fn find_frames(&mut self) -> io::Result<()> {
        let length = self.file.metadata()?.len();
        loop {
            self.file.seek(SeekFrom::Start(self.end))?;
            let mut size = [0; 4];
            if self.file.read_exact(&mut size).is_err() {
                break;
            }
            let reported = u32::from_le_bytes(size);
            let body = u64::from(reported) + (ROOT + 12 * self.vertices) as u64;
            if reported > LONGEST || self.end + 4 + body + 4 > length {
                break;
            }
            let mut bytes = vec![0; body as usize + 4];
            self.file.read_exact(&mut bytes)?;
            let Some((body, sum)) = bytes.split_last_chunk::<4>() else {
                break;
            };
            let (report, rest) = body.split_at(reported as usize);
            let Ok(reported) = FrameReport::decode(report) else {
                break;
            };
            let frame = reported.index as usize;
            let is_new = self.range.contains(&frame) && !self.frames.contains_key(&(frame - self.range.start));
            if checksum(body) != u32::from_le_bytes(*sum) || !is_new {
                break;
            }
            let mut numbers = [0.0; ROOT / 8];
            for (number, bytes) in numbers.iter_mut().zip(rest.as_chunks::<8>().0) {
                *number = f64::from_le_bytes(*bytes);
            }
            let stored = StoredFrame {
                at: self.end + 4 + (report.len() + ROOT) as u64,
                root: root_of(&numbers),
                reported,
            };
            self.frames.insert(frame - self.range.start, stored);
            self.end += 4 + bytes.len() as u64;
        }
        self.file.set_len(self.end)
    }

    /// Adds a frame.
    pub(super) fn push(&mut self, frame: &AnimatedFrame, reported: &FrameReport) -> Result<(), CliFailure> {
        let mut body = reported.encode_to_vec();
        let report = body.len();
        body.extend(numbers_of(&frame.root).into_iter().flat_map(f64::to_le_bytes));
        let positions = frame.positions.iter().flat_map(|p| p.as_vec3().to_array());
        body.extend(positions.flat_map(f32::to_le_bytes));
        let mut bytes = (report as u32).to_le_bytes().to_vec();
        let sum = checksum(&body);
        bytes.append(&mut body);
        bytes.extend(sum.to_le_bytes());
        let written = self.file.seek(SeekFrom::Start(self.end));
        let written = written.and_then(|_| self.file.write_all(&bytes));
        written.map_err(|e| failure("write", &self.path, &e))?;
        let stored = StoredFrame {
            at: self.end + (4 + report + ROOT) as u64,
            root: frame.root,
            reported: reported.clone(),
        };
        self.frames.insert(frame.index - self.range.start, stored);
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// Where the vertices are in a frame, counted from the first of the animation.
    pub(super) fn positions(&mut self, frame: usize) -> io::Result<Vec<Vec3>> {
        self.positions_of(frame, 0..self.vertices)
    }

    /// Where some of them are.
    pub(super) fn positions_of(&mut self, frame: usize, vertices: Range<usize>) -> io::Result<Vec<Vec3>> {
        let mut bytes = vec![0; 12 * vertices.len()];
        let start = self.frames[&frame].at + 12 * vertices.start as u64;
        self.file.seek(SeekFrom::Start(start))?;
        self.file.read_exact(&mut bytes)?;
        let numbers = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
        let numbers: Vec<f32> = numbers.collect();
        Ok(numbers
            .as_chunks::<3>()
            .0
            .iter()
            .map(|p| Vec3::from_array(*p))
            .collect())
    }

    /// [`FramesFile::positions`], with a failure that says where.
    pub(super) fn read_positions(&mut self, frame: usize) -> Result<Vec<Vec3>, CliFailure> {
        self.positions(frame).map_err(|e| failure("read", &self.path, &e))
    }

    /// Takes the file away.
    pub(super) fn remove(&self) {
        // What stays costs room, and nothing else.
        let _ = fs::remove_file(&self.path);
    }
}

fn failure(what: &str, path: &Path, e: &io::Error) -> CliFailure {
    CliFailure::Input(format!("cannot {what} {}: {e}", path.display()))
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut sum = Crc::new();
    sum.update(bytes);
    sum.sum()
}

fn numbers_of(root: &RigidMotion) -> [f64; ROOT / 8] {
    let ([x, y, z, w], from, to) = (root.rotation.to_array(), root.from, root.to);
    [x, y, z, w, from.x, from.y, from.z, to.x, to.y, to.z]
}

fn root_of(numbers: &[f64; ROOT / 8]) -> RigidMotion {
    let [x, y, z, w, a, b, c, d, e, f] = *numbers;
    RigidMotion {
        rotation: DQuat::from_xyzw(x, y, z, w),
        from: DVec3::new(a, b, c),
        to: DVec3::new(d, e, f),
    }
}
