//! A model for the other modules: the rest mesh, and the files that it came from.

use super::apart::ParserStarter;
use super::{Error, FileSet, Format, Geometry, Limits, VertexAttributes};
use glam::DVec3;
use std::any::Any;
use std::fmt::Debug;
use std::ops::Deref;
use std::sync::{Arc, OnceLock};

/// A model that was read, with the files it came from. Dereferences to its [`Geometry`], so that `model.positions`,
/// `model.triangles` and the like read as fields of the model.
#[derive(Debug, Clone)]
pub struct Model {
    /// The format it came in.
    pub format: Format,
    /// The rest mesh that the files describe.
    pub geometry: Geometry,
    /// The files, kept byte for byte.
    pub files: FileSet,
    /// What the writers of its format have to remember beyond the files and the geometry.
    pub(super) notes: Arc<dyn FileNotes>,
    /// What starts a process for decoders in C and C++ when its files are read again.
    pub(super) apart: Option<ParserStarter>,
    /// What distinguishes its vertices, once computed.
    pub(super) attributes: OnceLock<VertexAttributes>,
}

/// What a format's reader has learnt of a file that its writers need.
pub(super) trait FileNotes: Any + Debug + Send + Sync {
    /// About how many bytes it holds in memory.
    fn bytes_held(&self) -> u64 {
        0
    }
}

impl Deref for Model {
    type Target = Geometry;

    fn deref(&self) -> &Geometry {
        &self.geometry
    }
}

impl Model {
    /// The notes of a format's reader; `None` for a model of another format.
    pub(super) fn notes<T: FileNotes>(&self) -> Option<&T> {
        let notes: &dyn Any = &*self.notes;
        notes.downcast_ref()
    }

    /// The notes of the reader of `format`, or the refusal to write a model of another format with its writer.
    pub(super) fn notes_or_refuse<T: FileNotes>(&self, format: Format) -> Result<&T, Error> {
        let problem = || format!("the model came as {}", self.format);
        self.notes().ok_or_else(|| Error::unwritable(format, problem()))
    }

    /// The limits for reading files that were written of it: none, and its decoders run where they ran for its own files.
    pub fn limits_of_written(&self) -> Limits {
        Limits {
            apart: self.apart,
            ..Limits::UNLIMITED
        }
    }

    /// Bytes held for the comparison of its vertices.
    pub fn attribute_bytes(&self) -> u64 {
        self.attributes.get().map_or(0, VertexAttributes::byte_size)
    }

    /// About how many bytes it holds in memory.
    pub fn bytes_held(&self) -> u64 {
        self.files.total_bytes() + self.bytes_beside_files()
    }

    /// As [`Model::bytes_held`], without those of the files.
    pub fn bytes_beside_files(&self) -> u64 {
        self.geometry.bytes_held() + self.notes.bytes_held() + self.attribute_bytes()
    }
}

/// Whether all positions are bit-identical.
pub(super) fn is_same(a: &[DVec3], b: &[DVec3]) -> bool {
    a.iter().zip(b).all(|(p, q)| position_bits(*p) == position_bits(*q))
}

/// The bits of a position: equal when nothing changed, which `==` does not say for zeros.
pub(super) fn position_bits(p: DVec3) -> [u64; 3] {
    p.to_array().map(f64::to_bits)
}
