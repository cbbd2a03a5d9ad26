//! The files that make a model, as they came and as they go.

use super::apart::ParserStarter;
use super::{Error, FollowedCounts, Format};
use bytes::Bytes;
use glam::DVec3;
use pliant_exec::progress::{self, Progress};
use pliant_mesh::BoundingBox;
use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

/// What was uploaded: one main file and the companions that it names: buffers and images of a glTF, material
/// libraries of an OBJ and their pictures. Nothing outside this set is ever read.
#[derive(Debug, Clone, Default)]
pub struct FileSet {
    /// Name of the main file, for messages and to find the format.
    pub name: String,
    /// The main file.
    pub main: Bytes,
    /// The other files by the relative name (percent-decoded) under which the model names them.
    pub companions: BTreeMap<String, Bytes>,
}

impl FileSet {
    /// A set of one file.
    pub fn single(name: impl Into<String>, main: impl Into<Bytes>) -> Self {
        Self {
            name: name.into(),
            main: main.into(),
            companions: BTreeMap::new(),
        }
    }

    /// Copies of the companions.
    pub(super) fn owned_companions(&self) -> BTreeMap<String, Vec<u8>> {
        let companions = self.companions.iter();
        companions.map(|(name, bytes)| (name.clone(), bytes.to_vec())).collect()
    }

    /// Bytes in all files.
    pub fn total_bytes(&self) -> u64 {
        self.main.len() as u64 + self.companions.values().map(|b| b.len() as u64).sum::<u64>()
    }
}

/// How large a model may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Render vertices.
    pub vertices: u64,
    /// Triangles after triangulation.
    pub triangles: u64,
    /// Bytes that decoding (compressed or sparse data) may take.
    pub decoded_bytes: u64,
    /// Bytes that the parsed text of a document may take, beside what it describes.
    pub document_bytes: u64,
    /// Whether primitives of points and lines in a glTF are read. Sessions from before this was possible do without.
    pub points_and_lines: bool,
    /// About how many triangles the surface around a model of Gaussian splats has.
    pub cage_triangles: u32,
    /// What starts a process for decoders in C and C++, so that they do not run in this one. `None`: they do.
    pub apart: Option<ParserStarter>,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            vertices: 20_000_000,
            triangles: 40_000_000,
            decoded_bytes: 4 << 30,
            document_bytes: 4 << 30,
            points_and_lines: true,
            cage_triangles: Self::CAGE_TRIANGLES,
            apart: None,
        }
    }
}

impl Limits {
    /// The default of [`Limits::cage_triangles`]. Records lack it: never change it.
    pub const CAGE_TRIANGLES: u32 = 20_000;

    /// What [`Error::TooLarge`] names of these limits.
    pub(super) const NAMES: [&str; 5] = [
        "vertices",
        "triangles",
        "the bytes of the parsed document",
        "the bytes that decoding takes",
        READING_MEMORY,
    ];

    /// For reading again what was already read once within the caller's limits.
    pub const UNLIMITED: Self = Self {
        vertices: u64::MAX,
        triangles: u64::MAX,
        decoded_bytes: u64::MAX,
        document_bytes: u64::MAX,
        points_and_lines: true,
        cage_triangles: Self::CAGE_TRIANGLES,
        apart: None,
    };

    /// Refuses more render vertices than allowed.
    pub(super) fn check_vertices(&self, seen: u64) -> Result<(), Error> {
        within("vertices", seen, self.vertices)
    }

    /// Refuses more triangles than allowed.
    pub(super) fn check_triangles(&self, seen: u64) -> Result<(), Error> {
        within("triangles", seen, self.triangles)
    }
}

/// The limits of one read, who waits for it, and the memory that it has reserved. Dereferences to the limits. Cloning shares it.
#[derive(Clone)]
pub(super) struct ReadWatch<'a> {
    limits: &'a Limits,
    progress: &'a dyn Progress,
    reserved: Arc<ReservedMemory>,
}

/// Bytes that one read has reserved, by what they are for.
#[derive(Debug, Default)]
struct ReservedMemory {
    /// The files themselves.
    files: u64,
    /// What decoding takes now.
    decoded: AtomicU64,
    /// The parsed text of a document.
    document: AtomicU64,
    /// The mesh in the making: its vertices and triangles so far.
    vertices: AtomicU64,
    triangles: AtomicU64,
    /// Bytes that the watcher has allowed.
    granted: AtomicU64,
}

impl ReservedMemory {
    /// Bytes of a vertex while it is read: position, normal and tangent, and the numbers that they are made of.
    const BYTES_PER_VERTEX: u64 = 128;
    /// Bytes of a triangle while it is read: its corners in the file, as they are cut, and in the mesh.
    const BYTES_PER_TRIANGLE: u64 = 48;
    /// Bytes that the watcher is asked for ahead, so that it is not asked for every row of a file.
    const STEP: u64 = 1 << 20;

    fn total(&self) -> u64 {
        let mesh = [
            (&self.vertices, Self::BYTES_PER_VERTEX),
            (&self.triangles, Self::BYTES_PER_TRIANGLE),
        ];
        let mesh = mesh.map(|(count, bytes)| count.load(Relaxed).saturating_mul(bytes));
        [self.decoded.load(Relaxed), self.document.load(Relaxed)]
            .into_iter()
            .chain(mesh)
            .fold(self.files, u64::saturating_add)
    }
}

impl<'a> ReadWatch<'a> {
    /// Within `limits`, until `progress` is cancelled. `files` bytes are held already.
    pub(super) fn new(limits: &'a Limits, progress: &'a dyn Progress, files: u64) -> Self {
        let reserved = ReservedMemory {
            files,
            ..ReservedMemory::default()
        };
        Self {
            limits,
            progress,
            reserved: Arc::new(reserved),
        }
    }

    /// Who waits for the read.
    pub(super) fn progress(&self) -> &'a dyn Progress {
        self.progress
    }

    /// Reserves bytes that another process holds for the read, beside the files here.
    pub(super) fn reserve_apart(&self, bytes: u64) -> Result<(), Error> {
        let bytes = bytes.saturating_add(self.reserved.files);
        if self.progress.may_hold(bytes) {
            Ok(())
        } else {
            Err(self.lacks_memory(bytes))
        }
    }

    fn lacks_memory(&self, bytes: u64) -> Error {
        Error::TooLarge {
            what: READING_MEMORY,
            seen: bytes,
            limit: self.decoded_bytes,
        }
    }

    /// Stops the read once it is cancelled.
    pub(super) fn check(&self) -> Result<(), Error> {
        progress::check(self.progress).map_err(|_| Error::Cancelled)
    }

    /// As [`ReadWatch::check`], for every 4096th of many items.
    pub(super) fn check_at(&self, item: usize) -> Result<(), Error> {
        if item.is_multiple_of(4096) {
            self.check()
        } else {
            Ok(())
        }
    }

    /// Refuses a document whose parsed text would take more bytes than allowed, and reserves them, before it is parsed.
    pub(super) fn check_document(&self, bytes: u64) -> Result<(), Error> {
        within("the bytes of the parsed document", bytes, self.document_bytes)?;
        self.reserved.document.fetch_max(bytes, Relaxed);
        self.ask()
    }

    /// Refuses more render vertices in all than allowed, and reserves the memory that they take.
    pub(super) fn check_vertices(&self, seen: u64) -> Result<(), Error> {
        within("vertices", seen, self.vertices.min(u32::MAX.into()))?;
        self.reserved.vertices.fetch_max(seen, Relaxed);
        self.ask()
    }

    /// Refuses more triangles in all than allowed, and reserves the memory that they take.
    pub(super) fn check_triangles(&self, seen: u64) -> Result<(), Error> {
        // Tables count corners with 32 bits, whatever the caller allows.
        within("triangles", seen, self.triangles.min((u32::MAX / 3).into()))?;
        self.reserved.triangles.fetch_max(seen, Relaxed);
        self.ask()
    }

    /// Reserves bytes that decoding is about to take.
    pub(super) fn reserve(&self, bytes: u64) -> Result<(), Error> {
        let before = self.reserved.decoded.load(Relaxed);
        let decoded = before.saturating_add(bytes);
        within("the bytes that decoding takes", decoded, self.decoded_bytes)?;
        self.reserved.decoded.store(decoded, Relaxed);
        self.ask().inspect_err(|_| self.reserved.decoded.store(before, Relaxed))
    }

    /// Gives back bytes that decoding has reserved and does not hold any more.
    pub(super) fn release(&self, bytes: u64) {
        let decoded = self.reserved.decoded.load(Relaxed);
        self.reserved.decoded.store(decoded.saturating_sub(bytes), Relaxed);
    }

    /// Asks whether all that is reserved may be held.
    fn ask(&self) -> Result<(), Error> {
        let (bytes, granted) = (self.reserved.total(), self.reserved.granted.load(Relaxed));
        if bytes <= granted {
            return Ok(());
        }
        let ahead = bytes.saturating_add(ReservedMemory::STEP);
        let allowed = [ahead, bytes].into_iter().find(|&b| self.progress.may_hold(b));
        match allowed {
            Some(allowed) => self.reserved.granted.store(allowed, Relaxed),
            None => return Err(self.lacks_memory(bytes)),
        }
        Ok(())
    }
}

/// What [`Error::TooLarge`] names where the memory of a read is refused.
const READING_MEMORY: &str = "the memory that reading the model takes in bytes";

impl Deref for ReadWatch<'_> {
    type Target = Limits;

    fn deref(&self) -> &Limits {
        self.limits
    }
}

/// Refuses a main file whose places do not fit 32 bits, which the readers of texts count with.
pub(super) fn check_main_size(bytes: &[u8]) -> Result<(), Error> {
    within("bytes of the main file", bytes.len() as u64, u64::from(u32::MAX))
}

/// Refuses more of something than allowed.
pub(super) fn within(what: &'static str, seen: u64, limit: u64) -> Result<(), Error> {
    if seen > limit {
        Err(Error::TooLarge { what, seen, limit })
    } else {
        Ok(())
    }
}

/// A model written to bytes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WrittenFiles {
    /// The main file.
    pub main: Vec<u8>,
    /// Companions by name: buffers and images of a .gltf, material libraries of an OBJ and their pictures.
    pub companions: BTreeMap<String, Vec<u8>>,
    /// What in them followed the model's shape.
    pub followed: FollowedCounts,
    /// What of the model is not in them, or may not fit any more.
    pub warnings: Vec<WrittenWarning>,
}

/// Something of a model that a written file does not hold, or that may not fit what it holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WrittenWarning {
    /// A word for programs: `left-out`, `extension-kept`, `extension-dropped`, `places-rounded`.
    pub code: &'static str,
    /// What it is, in a sentence.
    pub message: String,
    /// Where in the model's file.
    pub place: String,
}

impl WrittenWarning {
    pub(super) fn new(code: &'static str, message: impl Into<String>, place: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
            place: place.into(),
        }
    }

    /// Of places that a file of `format` holds as 32-bit numbers far from the origin, and by how much they are rounded there; `None`
    /// where they lose nothing, or next to nothing.
    pub(super) fn rounded(positions: &[DVec3], format: Format) -> Option<Self> {
        let bounds = BoundingBox::of(positions);
        let off = |p: &DVec3| (p.as_vec3().as_dvec3() - *p).abs().max_element();
        let most = positions.iter().map(off).fold(0.0, f64::max);
        let far = bounds.min.abs().max(bounds.max.abs()).max_element();
        let message = format!(
            "numbers of the {format} have seven digits: at coordinates of {far:.3e} places are up to {most:.1e} off; obj, ply and off keep \
             places as they are"
        );
        (bounds.is_far() && most > 0.0).then(|| Self::new("places-rounded", message, ""))
    }

    /// Of things that a file of `format` does not hold, each with its number; `None` where there are none.
    pub(super) fn left_out(things: &[String], format: impl std::fmt::Display, of: &str) -> Option<Self> {
        let message = format!("{of}the {format} file has not: {}", things.join(", "));
        (!things.is_empty()).then(|| Self::new("left-out", message, ""))
    }
}

/// So many of something, by what one and several are called; `None` of none.
pub(super) fn counted(count: usize, one: &str, several: &str) -> Option<String> {
    match count {
        0 => None,
        1 => Some(format!("1 {one}")),
        _ => Some(format!("{count} {several}")),
    }
}

impl WrittenFiles {
    /// A main file and its companions.
    pub(super) fn of(main: Vec<u8>, companions: BTreeMap<String, Vec<u8>>) -> Self {
        Self {
            main,
            companions,
            ..Self::default()
        }
    }

    /// A model of one file.
    pub(super) fn single(main: Vec<u8>) -> Self {
        Self {
            main,
            ..Self::default()
        }
    }

    /// The files as a set to be read, with a name for the main file.
    pub fn into_files(self, name: impl Into<String>) -> FileSet {
        let companions = self.companions.into_iter();
        FileSet {
            name: name.into(),
            main: self.main.into(),
            companions: companions.map(|(name, bytes)| (name, bytes.into())).collect(),
        }
    }

    /// The uploaded files as they came.
    pub(super) fn from_upload(files: &FileSet) -> Self {
        Self {
            main: files.main.to_vec(),
            companions: files.owned_companions(),
            ..Self::default()
        }
    }
}
