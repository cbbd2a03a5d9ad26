//! What identifies a model format: its name, its media types and how its files begin.
//!
//! Owns the type only. Which formats there are is said in one place, the registry in [`formats`](super::formats).

use std::fmt;
use std::hash::{Hash, Hasher};

/// A model format that pliant reads and writes, such as [`Format::GLB`].
///
/// # Example
/// ```
/// use pliant_core::asset::Format;
///
/// assert_eq!(Format::from_file_name("chair.PLY"), Some(Format::PLY));
/// assert_eq!(Format::from_media_type("model/obj; charset=utf-8"), Some(Format::OBJ));
/// // The content identifies the format.
/// assert_eq!(Format::from_bytes(b"OFF\n3 1 0\n"), Some(Format::OFF));
/// assert_eq!(Format::from_bytes(b"<html>"), None);
/// assert_eq!(Format::GLB.media_type(), "model/gltf-binary");
/// ```
#[derive(Clone, Copy)]
pub struct Format(&'static FormatDetails);

/// What one format is known by.
pub(super) struct FormatDetails {
    /// The name used in requests and as file extension, in lower case.
    pub name: &'static str,
    /// The registered or customary media type, then other ones that clients send.
    pub media_types: &'static [&'static str],
    /// Says how surely a file without its byte-order mark is of this format.
    pub recognise: fn(&[u8]) -> Recognition,
}

/// How surely a file's content identifies its format. The surest format is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Recognition {
    /// The content does not look like the format.
    Unlikely,
    /// The first words are words of the format.
    Words,
    /// The file carries the format's mark, or has a structure that others have by chance only.
    Mark,
}

impl Recognition {
    /// [`Recognition::Mark`] where `found`.
    pub(super) fn mark(found: bool) -> Self {
        if found { Self::Mark } else { Self::Unlikely }
    }

    /// [`Recognition::Words`] where `found`.
    pub(super) fn words(found: bool) -> Self {
        if found { Self::Words } else { Self::Unlikely }
    }
}

impl Format {
    /// The format of these details, of which the registry has one row.
    pub(super) const fn new(details: &'static FormatDetails) -> Self {
        Self(details)
    }

    /// The details that the registry searches.
    pub(super) fn details(self) -> &'static FormatDetails {
        self.0
    }

    /// The name used in requests and as file extension.
    pub fn name(self) -> &'static str {
        self.0.name
    }

    /// The registered or customary media type.
    pub fn media_type(self) -> &'static str {
        self.0
            .media_types
            .first()
            .copied()
            .unwrap_or("application/octet-stream")
    }
}

impl PartialEq for Format {
    fn eq(&self, other: &Self) -> bool {
        self.0.name == other.0.name
    }
}

impl Eq for Format {}

impl Hash for Format {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.name.hash(state);
    }
}

impl fmt::Debug for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name)
    }
}
