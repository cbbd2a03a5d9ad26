//! The partial file beside an output: the frames that have been solved so far, so that a stopped animation can go on.
//!
//! A mark, the length of a text, the text that says what the frames are of, and then frames. A frame is the length of its
//! report, the report as protobuf, ten doubles of what its root does, its positions as 32-bit floats, and a checksum. One that was
//! not written to its end is cut off. Frames stand in the order in which they were solved.

use super::numbered::first_difference;
use crate::cli::failure::CliFailure;
use crate::cli::input_files::open_regular_file;
use crate::engine::AnimatedFrame;
use crate::motion::rig::RigidMotion;
use crate::wire::pb::animation_report::FrameReport;
use flate2::Crc;
use glam::{DQuat, DVec3, Vec3};
use prost::Message as _;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};

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
    pub(super) told: FrameReport,
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
            // Taken away first, and made anew: through a link that lies there, another file would be written over.
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
            let told = u32::from_le_bytes(size);
            let body = u64::from(told) + (ROOT + 12 * self.vertices) as u64;
            if told > LONGEST || self.end + 4 + body + 4 > length {
                break;
            }
            let mut bytes = vec![0; body as usize + 4];
            self.file.read_exact(&mut bytes)?;
            let Some((body, sum)) = bytes.split_last_chunk::<4>() else {
                break;
            };
            let (report, rest) = body.split_at(told as usize);
            let Ok(told) = FrameReport::decode(report) else { break };
            let frame = told.index as usize;
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
                told,
            };
            self.frames.insert(frame - self.range.start, stored);
            self.end += 4 + bytes.len() as u64;
        }
        self.file.set_len(self.end)
    }

    /// Adds a frame.
    pub(super) fn push(&mut self, frame: &AnimatedFrame, told: &FrameReport) -> Result<(), CliFailure> {
        let mut body = told.encode_to_vec();
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
            told: told.clone(),
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
