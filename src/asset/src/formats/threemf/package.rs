//! The package of a 3MF: a ZIP archive with parts by name, of which one is the model.
//!
//! Nothing is unpacked to a disk: names of parts are looked up in the archive and lead nowhere else. What a part unpacks to is reserved
//! as it grows, and is refused where it is longer than the archive says.

use crate::files::ReadWatch;
use crate::format::{FormatDetails, Recognition};
use crate::{Error, Format};
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Cursor, Read, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// The format, by what it is known.
pub(in super::super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "3mf",
    aliases: &[],
    media_types: &[
        "model/3mf",
        "application/vnd.ms-package.3dmanufacturing-3dmodel+xml",
        "application/3mf",
    ],
    recognise,
});

/// Bytes at the begin and at the end of an archive in which names of its parts are looked for.
const SEARCHED: usize = 1 << 16;

fn recognise(bytes: &[u8]) -> Recognition {
    if !bytes.starts_with(b"PK\x03\x04") {
        return Recognition::Unlikely;
    }
    let begin = &bytes[..bytes.len().min(SEARCHED)];
    let end = &bytes[bytes.len().saturating_sub(SEARCHED)..];
    let names_model = |part: &[u8]| part.windows(6).any(|word| word.eq_ignore_ascii_case(b".model"));
    Recognition::mark(names_model(begin) || names_model(end))
}

/// Parts that a package may have.
const MOST_PARTS: usize = 65_536;
/// Bytes that one compressed byte becomes at most, by the rules of Deflate.
const MOST_EXPANSION: u64 = 1_040;
/// Bytes that are reserved at once while a part is unpacked.
const STEP: u64 = 1 << 20;
/// The relationship of a package to its model.
const MODEL_RELATION: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";

/// A package that is open.
pub(super) struct Package<'a> {
    archive: ZipArchive<Cursor<&'a [u8]>>,
    /// The names of its parts, with the place in the archive of each.
    names: Vec<String>,
}

impl<'a> Package<'a> {
    /// Opens an archive.
    pub fn open(bytes: &'a [u8]) -> Result<Self, Error> {
        let archive = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| refuse("file", format!("is not a ZIP archive: {error}")))?;
        if archive.len() > MOST_PARTS {
            let problem = format!("has {} parts, at most {MOST_PARTS} are read", archive.len());
            return Err(refuse("file", problem));
        }
        let names = archive.file_names_raw();
        let names = names.map(|name| String::from_utf8_lossy(name).into_owned()).collect();
        Ok(Self { archive, names })
    }

    /// The place of a part; names are compared without regard to case, as packages of documents do.
    fn find(&self, name: &str) -> Option<usize> {
        let name = name.trim_start_matches('/');
        let mut names = self.names.iter();
        names.position(|own| own.trim_start_matches('/').eq_ignore_ascii_case(name))
    }

    /// A part's bytes; `None` where the package has no such part. They stay reserved: the caller releases them.
    pub fn part(&mut self, name: &str, watch: &ReadWatch<'_>) -> Result<Option<Vec<u8>>, Error> {
        let Some(place) = self.find(name) else { return Ok(None) };
        let broken = |error: &dyn std::fmt::Display| refuse(name, format!("cannot be unpacked: {error}"));
        let mut file = self.archive.by_index(place).map_err(|error| broken(&error))?;
        let (size, packed) = (file.size(), file.compressed_size());
        if size > packed.saturating_mul(MOST_EXPANSION).saturating_add(STEP) {
            return Err(refuse(
                name,
                format!("{packed} bytes are said to become {size}, which no Deflate does"),
            ));
        }
        let mut bytes = Vec::new();
        loop {
            watch.check()?;
            watch.reserve(STEP)?;
            let read = (&mut file)
                .take(STEP)
                .read_to_end(&mut bytes)
                .map_err(|error| broken(&error))?;
            watch.release(STEP - (read as u64).min(STEP));
            if bytes.len() as u64 > size {
                return Err(refuse(
                    name,
                    format!("is longer than the {size} bytes that the archive says"),
                ));
            }
            if read == 0 {
                return Ok(Some(bytes));
            }
        }
    }

    /// The name of the part that the model begins with.
    pub fn model_part(&mut self, watch: &ReadWatch<'_>) -> Result<String, Error> {
        let relations = self.part("_rels/.rels", watch)?.unwrap_or_default();
        let mut target = None;
        each_relation(&relations, |kind, to| {
            if kind == MODEL_RELATION && target.is_none() {
                target = Some(to.to_owned());
            }
        });
        watch.release(relations.len() as u64);
        let is_model = |name: &&String| name.to_ascii_lowercase().ends_with(".model");
        let named = target.filter(|name| self.find(name).is_some());
        let first = || self.names.iter().find(is_model).cloned();
        named.or_else(first).ok_or_else(|| {
            let problem = "is a ZIP archive without the part of a 3D model (3D/3dmodel.model)";
            Error::NoMesh {
                format: FORMAT,
                problem: problem.into(),
            }
        })
    }

    /// The package with some parts replaced and some added; all others are copied as they are packed.
    pub fn rewritten(&mut self, mut parts: BTreeMap<String, Vec<u8>>) -> Result<Vec<u8>, Error> {
        let mut out = ZipWriter::new(Cursor::new(Vec::new()));
        let broken = |error: zip::result::ZipError| Error::unwritable(FORMAT, format!("the archive: {error}"));
        for (place, name) in self.names.clone().iter().enumerate() {
            let key = parts
                .keys()
                .find(|key| key.trim_start_matches('/').eq_ignore_ascii_case(name));
            if let Some(key) = key.cloned() {
                let bytes = parts.remove(&key).unwrap_or_default();
                push_part(&mut out, name, &bytes)?;
                continue;
            }
            let file = self.archive.by_index_raw(place).map_err(broken)?;
            out.raw_copy_file(file).map_err(broken)?;
        }
        for (name, bytes) in &parts {
            push_part(&mut out, name.trim_start_matches('/'), bytes)?;
        }
        Ok(out.finish().map_err(broken)?.into_inner())
    }

    /// Names of the parts that lie beside the model: pictures of it, settings of printers.
    pub fn beside(&self, models: &BTreeSet<String>) -> Vec<&str> {
        let own = |name: &&String| {
            let lower = name.to_ascii_lowercase();
            let is_frame = lower.ends_with(".rels") || lower == "[content_types].xml" || lower.ends_with('/');
            !is_frame
                && !models
                    .iter()
                    .any(|m| m.trim_start_matches('/').eq_ignore_ascii_case(name))
        };
        self.names.iter().filter(own).map(String::as_str).collect()
    }
}

/// A fresh package.
pub(super) fn pack(parts: &[(String, Vec<u8>)]) -> Result<Vec<u8>, Error> {
    let mut out = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in parts {
        push_part(&mut out, name, bytes)?;
    }
    let done = out
        .finish()
        .map_err(|error| Error::unwritable(FORMAT, format!("the archive: {error}")))?;
    Ok(done.into_inner())
}

fn push_part(out: &mut ZipWriter<Cursor<Vec<u8>>>, name: &str, bytes: &[u8]) -> Result<(), Error> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .large_file(u32::try_from(bytes.len()).is_err());
    let broken = |error: &dyn std::fmt::Display| Error::unwritable(FORMAT, format!("the archive: {error}"));
    out.start_file(name, options).map_err(|error| broken(&error))?;
    out.write_all(bytes).map_err(|error| broken(&error))
}

/// Hands out kind and target of the relationships that a part of them names.
fn each_relation(bytes: &[u8], mut each: impl FnMut(&str, &str)) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let mut reader = Reader::from_str(text);
    while let Ok(event) = reader.read_event() {
        match event {
            Event::Eof => return,
            Event::Start(element) | Event::Empty(element) if element.local_name().as_ref() == "Relationship" => {
                let of = |name: &str| attribute_of(&element, name).unwrap_or_default();
                each(&of("Type"), &of("Target"));
            }
            _ => {}
        }
    }
}

/// An attribute of an element by its name without a prefix, unescaped.
pub(super) fn attribute_of(element: &BytesStart<'_>, name: &str) -> Option<String> {
    let mut all = element.attributes();
    let found = all
        .with_checks(false)
        .flatten()
        .find(|a| a.key.local_name().as_ref() == name)?;
    Some(unescaped(&found.value))
}

/// Text with its five entities and numbered letters in place; as it is where it has others, which are never expanded.
pub(super) fn unescaped(raw: &str) -> String {
    quick_xml::escape::unescape(raw).map_or_else(|_| raw.to_owned(), |text| text.into_owned())
}

/// The refusal of a package at a place.
pub(super) fn refuse(place: impl Into<String>, problem: impl Into<String>) -> Error {
    Error::malformed(FORMAT, place, problem)
}
