//! The files that make a model, as they came and as they go.

use super::{Error, FollowedCounts};
use crate::progress::{self, Progress};
use bytes::Bytes;
use std::collections::BTreeMap;
use std::ops::Deref;

/// What was uploaded: one main file and the companions that it names: buffers and images of a glTF, material
/// libraries of an OBJ and their pictures. Nothing outside this set is ever read.
#[derive(Debug, Clone, Default)]
pub struct FileSet {
    /// Name of the main file; only used in texts and to tell the format.
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
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            vertices: 20_000_000,
            triangles: 40_000_000,
            decoded_bytes: 4 << 30,
            document_bytes: 4 << 30,
        }
    }
}

impl Limits {
    /// Refuses more render vertices than allowed.
    pub(super) fn check_vertices(&self, seen: u64) -> Result<(), Error> {
        within("vertices", seen, self.vertices)
    }

    /// Refuses more triangles than allowed.
    pub(super) fn check_triangles(&self, seen: u64) -> Result<(), Error> {
        within("triangles", seen, self.triangles)
    }
}

/// The limits of one read, and who waits for it. Dereferences to the limits.
#[derive(Clone, Copy)]
pub(super) struct ReadWatch<'a> {
    limits: &'a Limits,
    progress: &'a dyn Progress,
}

impl<'a> ReadWatch<'a> {
    /// Within `limits`, until `progress` is cancelled.
    pub(super) fn new(limits: &'a Limits, progress: &'a dyn Progress) -> Self {
        Self { limits, progress }
    }

    /// Stops the read when nobody wants it any more.
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

    /// Refuses a document whose parsed text would take more bytes than allowed, before it is parsed.
    pub(super) fn check_document(&self, bytes: u64) -> Result<(), Error> {
        within("the bytes of the parsed document", bytes, self.document_bytes)
    }
}

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

fn within(what: &'static str, seen: u64, limit: u64) -> Result<(), Error> {
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
}

impl WrittenFiles {
    /// A model of one file.
    pub(super) fn single(main: Vec<u8>) -> Self {
        Self {
            main,
            ..Self::default()
        }
    }

    /// The uploaded files as they came.
    pub(super) fn from_upload(files: &FileSet) -> Self {
        let companions = files.companions.iter();
        Self {
            main: files.main.to_vec(),
            companions: companions.map(|(uri, bytes)| (uri.clone(), bytes.to_vec())).collect(),
            ..Self::default()
        }
    }
}
