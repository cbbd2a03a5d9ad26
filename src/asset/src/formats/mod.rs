//! The registry of formats, and one folder or file for each.
//!
//! Every format is one row of the table below: the name of its constant, its [`Format`] with everything it is known by
//! (name and extension, media types, how its files begin), and the [`FormatCodec`] that reads and writes it. Texts,
//! media types and the API's description are made from [`Format::ALL`]; step 5 names what is written by hand beside it.
//! A format that is read only has a row with a [`FormatTranslator`], which makes files of another format of its files; it
//! stands in [`Format::READ`] alone.
//!
//! # How to add a format
//! 1. Add a file `NAME.rs` (or a folder) here, and `mod NAME;` below.
//! 2. In it, say what the format is known by, and pick what the reader has to remember of a file for the writers:
//!    ```text
//!    pub(super) const FORMAT: Format = Format::new(&FormatDetails {
//!        name: "tri",
//!        aliases: &[],
//!        media_types: &["model/x.tri"],
//!        recognise: |bytes| Recognition::mark(bytes.starts_with(b"TRI1")),
//!    });
//!
//!    #[derive(Debug)]
//!    struct TriNotes { first_vertex: usize }
//!    impl FileNotes for TriNotes {}
//!    ```
//! 3. Implement [`FormatCodec`](super::codec::FormatCodec) for a unit struct `TriCodec`: `read`, `patch_positions`,
//!    `build`, `write_edited`, `patches_files_of`, and `run_attributes` where the format has colours, texture coordinates or materials.
//!    Errors name the format's `FORMAT`; [`Geometry::check`](super::Geometry) is done for every reader by the caller.
//!    [`text`] reads and patches words and numbers, [`polygons`] cuts faces into triangles, and
//!    [`CarriedAttributes`](super::edited::CarriedAttributes) and
//!    [`TriangleOrigins`](super::edited::TriangleOrigins) carry what an edit moves.
//! 4. Add the row to the table. The tests of `tests/` that walk over [`Format::ALL`] take it from there.
//!    [`Format::from_file`] tries the first bytes before the name, and among equally sure rows the first one is taken:
//!    content alone must distinguish a text format from others.
//! 5. Say it where people and other languages read: the comments of `format` in `proto/pliant/v1/pliant.proto` (then
//!    `proto/clients/python/generate` and `npm run generate` in `proto/clients/typescript`), `deploy/docs/formats.md`,
//!    `tour.md`, `FORMAT` and `OPENED_FORMAT` in `src/server/src/http/route_table.rs`, Python's `model.py`, `options.py` and
//!    `batch/jobs.py`, TypeScript's `session.ts` and `client.ts`, the help of `src/cli` and `loadtest`, and the viewer's
//!    `src/app/opening.ts` and `src/ui/TopBar.tsx`.
//! 6. Test it: seeds in `tests/assets/roundtrip_text.rs` and `tests/fuzz/corpora.rs`, a target in `tests/fuzz/targets/mod.rs`; tests that
//!    spell the list of formats fail until they name it.

mod fbx;
mod gltf;
mod obj;
mod off;
mod ply;
mod polygons;
mod splats;
mod stl;
mod text;
mod threemf;

pub use splats::{SplatMotion, SplatPlaces, Splats};

use crate::apart::{AnsweredCalls, DecoderCall};
use crate::codec::{FormatCodec, FormatTranslator};
use crate::format::{Format, Recognition};
use crate::{Error, FileSet, Model};
use splats::SplatModelCodec;
use std::io::{self, Read, Write};

/// Makes the constants of [`Format`] and the tables of codecs and translators from the rows of the registry.
macro_rules! registry {
    (
        read and written { $($(#[$about:meta])* $name:ident = $format:expr, $codec:expr;)* }
        only read { $($(#[$note:meta])* $source:ident = $source_format:expr, $translator:expr;)* }
        of splats { $($(#[$of:meta])* $cloud:ident = $cloud_format:expr;)* }
    ) => {
        impl Format {
            $($(#[$about])* pub const $name: Self = $format;)*
            $($(#[$note])* pub const $source: Self = $source_format;)*
            $($(#[$of])* pub const $cloud: Self = $cloud_format;)*

            /// Every format of meshes that is read and written, in the order in which texts list them.
            pub const ALL: [Self; [$(stringify!($name)),*].len()] = [$(Self::$name),*];

            /// Every format that is read: those of [`Format::ALL`], those whose models become one of them, and those of splats.
            pub const READ: [Self; [$(stringify!($name),)* $(stringify!($source),)* $(stringify!($cloud)),*].len()] =
                [$(Self::$name,)* $(Self::$source,)* $(Self::$cloud),*];

            /// The formats that hold Gaussian splats and nothing else.
            pub const SPLATS: [Self; [$(stringify!($cloud)),*].len()] = [$(Self::$cloud),*];
        }

        /// The codec of each format, in the order of [`Format::ALL`].
        static CODECS: [&dyn FormatCodec; Format::ALL.len()] = [$(&$codec),*];

        /// The translator of each format that is read only.
        static TRANSLATORS: &[(Format, &dyn FormatTranslator)] = &[$((Format::$source, &$translator)),*];
    };
}

registry! {
    read and written {
        /// Binary glTF 2.0.
        GLB = gltf::GLB_FORMAT, gltf::GltfCodec;
        /// glTF 2.0 as JSON, with embedded buffers or companions.
        GLTF = gltf::GLTF_FORMAT, gltf::GltfCodec;
        /// Wavefront OBJ.
        OBJ = obj::FORMAT, obj::ObjCodec;
        /// Stanford PLY, ASCII or binary.
        PLY = ply::FORMAT, ply::PlyCodec;
        /// Object File Format.
        OFF = off::FORMAT, off::OffCodec;
        /// Stereolithography, ASCII or binary.
        STL = stl::FORMAT, stl::StlCodec;
        /// 3D Manufacturing Format, of printers.
        THREE_MF = threemf::FORMAT, threemf::ThreeMfCodec;
    }
    only read {
        /// Autodesk FBX; what is made of it is a GLB.
        FBX = fbx::FORMAT, fbx::FbxTranslator;
    }
    of splats {
        /// Records of 32 bytes, one for each Gaussian splat.
        SPLAT = splats::SPLAT_FORMAT;
        /// Niantic's packed Gaussian splats.
        SPZ = splats::SPZ_FORMAT;
    }
}

/// The translator of a format that is read only; `None` for those with a codec.
pub(super) fn translator_of(format: Format) -> Option<&'static dyn FormatTranslator> {
    let mut rows = TRANSLATORS.iter();
    rows.find(|(source, _)| *source == format)
        .map(|(_, translator)| *translator)
}

/// The codec that writes a format.
pub(super) fn writer_of(format: Format) -> Result<&'static dyn FormatCodec, Error> {
    match format.refusal_to_write() {
        Some(problem) => Err(Error::unwritable(format, problem)),
        None => Ok(codec_of(format)),
    }
}

/// What becomes of each extension of glTF when a model's shape changes, as a table of Markdown: that of `deploy/docs/formats.md`.
pub fn gltf_extension_table() -> String {
    gltf::extension_table()
}

/// Answers the calls of decoders that another process sends, until it sends no more: what the process of a
/// [`ParserStarter`](super::ParserStarter) runs.
///
/// # Errors
/// When a call cannot be understood, or the other side is gone.
pub fn answer_parser_calls(input: &mut (dyn Read + Send), output: &mut (dyn Write + Send)) -> io::Result<()> {
    let mut calls = AnsweredCalls { input, output };
    while let Some(DecoderCall { decoder, call, parts }) = calls.next()? {
        match &*decoder {
            fbx::DECODER => fbx::answer(call, parts, &mut calls)?,
            gltf::MESHOPT_DECODER => gltf::answer_meshopt(call, &parts, &mut calls)?,
            _ => return Err(io::ErrorKind::InvalidInput.into()),
        }
    }
    Ok(())
}

/// The codec that reads files.
pub(super) fn reader_of(files: &FileSet, format: Format) -> &'static dyn FormatCodec {
    match Splats::format_of(files, Some(format)) {
        Some(_) => &SplatModelCodec,
        None => codec_of(format),
    }
}

impl Model {
    /// The codec that has read it.
    pub(super) fn codec(&self) -> &'static dyn FormatCodec {
        match self.holds_splats() {
            true => &SplatModelCodec,
            false => codec_of(self.format),
        }
    }

    /// The codec that writes it in a format.
    ///
    /// # Errors
    /// [`Error::Unwritable`] for a format that is read only.
    pub(super) fn writer(&self, format: Format) -> Result<&'static dyn FormatCodec, Error> {
        match self.holds_splats() && format.holds_splats() {
            true => Ok(&SplatModelCodec),
            false => writer_of(format),
        }
    }
}

/// The codec that reads and writes meshes of a format, or splats.
pub(super) fn codec_of(format: Format) -> &'static dyn FormatCodec {
    if format.holds_splats_alone() {
        return &SplatModelCodec;
    }
    // A format is made here only and models are of formats with codecs, so the last one stands for none that exists.
    let row = Format::ALL.iter().position(|f| *f == format);
    CODECS[row.unwrap_or(CODECS.len() - 1)]
}

impl Format {
    /// The names of the formats that are written, as texts list them: with `and`, "glb, gltf, obj, ply, off, stl, 3mf, splat and spz".
    pub fn name_list(conjunction: &str) -> String {
        let written: Vec<&str> = Self::written().map(Self::name).collect();
        list_of(&written, conjunction)
    }

    /// Every format that is written: those of meshes, then those of splats.
    fn written() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().chain(Self::SPLATS)
    }

    /// The names of the formats that are read: with `and`, "glb, gltf, obj, ply, off, stl, 3mf, fbx, splat and spz".
    pub fn read_name_list(conjunction: &str) -> String {
        list_of(&Self::READ.map(Self::name), conjunction)
    }

    /// Why results cannot be had in this format; `None` for those that are written.
    pub fn refusal_to_write(self) -> Option<String> {
        let is_written = Self::written().any(|format| format == self);
        (!is_written).then(|| format!("{self} is read, not written; choose {}", Self::name_list("or")))
    }

    /// The format of that name, in any case; an avatar (`vrm`) is a GLB.
    pub fn from_name(name: &str) -> Option<Self> {
        let goes_by = |format: &Self| {
            let mut names = [format.name()]
                .into_iter()
                .chain(format.details().aliases.iter().copied());
            names.any(|own| own.eq_ignore_ascii_case(name))
        };
        Self::READ.into_iter().find(goes_by)
    }

    /// The format of a media type, parameters ignored; `None` for general ones such as `application/octet-stream`.
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        let essence = media_type.split(';').next().unwrap_or_default().trim();
        let is_named = |f: &Self| f.details().media_types.iter().any(|t| essence.eq_ignore_ascii_case(t));
        Self::READ.into_iter().find(is_named)
    }

    /// Finds the format of a file: by its first bytes, else by its name.
    pub fn from_file(name: &str, bytes: &[u8]) -> Option<Self> {
        Self::from_bytes(bytes).or_else(|| Self::from_file_name(name))
    }

    /// The format of a file name's extension.
    pub fn from_file_name(name: &str) -> Option<Self> {
        name.rsplit_once('.')
            .and_then(|(_, extension)| Self::from_name(extension))
    }

    /// The format of a file's content. OBJ has no signature; its first keyword identifies it.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let bytes = text::without_mark(bytes);
        let sureness = |f: &Self| (f.details().recognise)(bytes);
        // Of two that are as sure the first one is taken.
        let surest = Self::READ.into_iter().rev().max_by_key(sureness)?;
        (sureness(&surest) > Recognition::Unlikely).then_some(surest)
    }
}

fn list_of(names: &[&str], conjunction: &str) -> String {
    match names.split_last() {
        Some((last, others)) => format!("{} {conjunction} {last}", others.join(", ")),
        None => String::new(),
    }
}
