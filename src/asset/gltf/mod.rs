//! glTF 2.0 and GLB, patched instead of rebuilt.
//!
//! What a deformation does not change comes back as it was: the JSON text outside the changed places to the byte, the
//! binary data outside the changed attributes, unknown extensions, extras, custom attributes, animations, skins, morph
//! targets. Existing indices never change; what is new is appended.
//!
//! Reading: [`container`] takes a GLB apart, [`document`] parses the sections that geometry needs out of the JSON
//! [`text`], [`check`] checks references and ranges, [`buffers`] finds bytes (with [`uri`] and [`compressed`]),
//! [`accessors`] reads them, [`scene`] places meshes, [`read`] puts triangles together. Writing: [`deformed`] computes
//! what each attribute should become, [`sharing`] decides which copies must part, [`patch`] edits text and bytes,
//! [`package`] makes the files. [`fresh`] makes an asset from other formats' geometry. After edits of the topology,
//! [`remade`] writes primitives anew.
//!
//! # Conventions
//! - Positions are in world space; a skinned mesh is in its bind pose, its node's transform ignored.
//! - Triangles of a mesh that is mirrored into the world (negative determinant) are wound the other way round than the
//!   file's indices, so that the outside is outside. The file's indices are never changed.
//! - Quantised and sparse attributes that change come back as plain floats in an accessor of their own.
//! - A vertex whose world position is equal to the rest pose's to the bit keeps its stored bytes.
//!
//! Must not: open files, fetch URIs, know of solving.

mod accessors;
mod buffers;
mod check;
mod compressed;
mod container;
mod deformed;
mod document;
mod fault;
mod fresh;
mod package;
mod patch;
mod read;
mod remade;
mod scene;
mod schema;
mod sharing;
#[cfg(test)]
mod tests;
mod text;
mod uri;

use super::plain::Plain;
use super::{Error, FileSet, Format, Geometry, Limits, Written};
use glam::DVec3;
pub(super) use remade::{extras, write as write_remade};

/// What writing needs to know beyond the files: where the rows of the primitive table came from.
#[derive(Debug, Clone)]
pub(crate) struct Source {
    format: Format,
    rows: Vec<read::Row>,
    /// Nodes of the scene that have a mesh, ascending.
    placed: Vec<usize>,
}

/// Reads a GLB or glTF model.
///
/// # Errors
/// Whatever is wrong with the container, the JSON, references, ranges or the geometry itself; a companion file that is
/// missing; compression that is not read; sizes above `limits`.
pub(crate) fn read(files: &FileSet, format: Format, limits: &Limits) -> Result<(Geometry, Source), Error> {
    read::read(files, format, limits)
}

/// Writes the model with new positions (one per render vertex, in world space), normals and tangents following.
///
/// # Errors
/// [`Error::Unwritable`] when positions do not fit: their number, not finite, moved under a node whose transform cannot
/// be inverted, or beyond 32-bit floats.
pub(crate) fn write(
    files: &FileSet,
    source: &Source,
    rest: &Geometry,
    positions: &[DVec3],
    format: Format,
) -> Result<Written, Error> {
    let doc = document::Document::parse(files, source.format)?;
    check::check(&doc)?;
    let unlimited = Limits {
        vertices: u64::MAX,
        triangles: u64::MAX,
        decoded_bytes: u64::MAX,
    };
    let mut buffers = buffers::Buffers::load(&doc, files, &unlimited)?;
    let wanted = deformed::wanted(&doc, &mut buffers, source, rest, positions, fault::Fault(format))?;
    let plan = sharing::plan(&doc, &buffers, source, rest, wanted);
    let patched = patch::patch(&doc, &buffers, plan)?;
    package::package(&doc, files, &buffers, patched, format)
}

/// Makes a fresh asset of a geometry that came from another format.
///
/// # Errors
/// [`Error::Unwritable`] when it has no triangles, a position is beyond 32-bit floats, or the result is too large.
pub(super) fn build(plain: &Plain, format: Format) -> Result<Written, Error> {
    fresh::build(plain, format)
}
