//! What identifies a model format: its name, its media types and how its files begin.
//!
//! Owns the type only. Which formats there are is said in one place, the registry in [`formats`](super::formats).

use std::fmt;
use std::hash::{Hash, Hasher};

/// A model format that pliant reads and writes, such as [`Format::GLB`].
///
/// # Example
/// ```
/// use pliant_asset::Format;
///
/// assert_eq!(Format::from_file_name("chair.PLY"), Some(Format::PLY));
/// assert_eq!(Format::from_media_type("model/obj; charset=utf-8"), Some(Format::OBJ));
/// // An avatar is a GLB by another name.
/// assert_eq!(Format::from_file_name("person.vrm"), Some(Format::GLB));
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
    /// Other names of the format and extensions of its files, in lower case.
    pub aliases: &'static [&'static str],
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

/// Why bytes are not a model that pliant can deform, or why it cannot be written as asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The bytes belong to no known format, and none was named.
    #[error("{place}: not a known model format; allowed are {allowed}")]
    UnknownFormat {
        /// File name as given.
        place: String,
        /// The names of the formats that there are.
        allowed: String,
    },
    /// The bytes break the rules of their format.
    #[error("{format}: {place}: {problem}")]
    Malformed {
        /// The format that the bytes were read as.
        format: Format,
        /// Where: a line number, a byte offset, or a JSON pointer such as `accessors/3/count`.
        place: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// Valid, but of a kind that pliant does not take.
    #[error("{format}: {place}: {problem}; {hint}")]
    Unsupported {
        /// The format that the bytes were read as.
        format: Format,
        /// Where in the file.
        place: String,
        /// What is not supported.
        problem: String,
        /// What the user can do about it.
        hint: String,
    },
    /// More than the caller's limits allow.
    #[error("{what} is {seen}, at most {limit} is allowed")]
    TooLarge {
        /// What is too large, such as `vertices`.
        what: &'static str,
        /// The size seen.
        seen: u64,
        /// The size allowed.
        limit: u64,
    },
    /// The work was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The process that should decode a file did not start; the file may be as good as any.
    #[error("the process that decodes the file did not start: {0}")]
    NotStarted(String),
    /// No triangle was found.
    #[error("{format}: no mesh: {problem}")]
    NoMesh {
        /// The format that the bytes were read as.
        format: Format,
        /// What the file holds instead.
        problem: String,
    },
    /// The positions to write do not fit the model.
    #[error("cannot write {format}: {problem}")]
    Unwritable {
        /// The format asked for.
        format: Format,
        /// Why.
        problem: String,
    },
}

impl Error {
    /// Bytes that break the rules of their format.
    pub(super) fn malformed(format: Format, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Malformed {
            format,
            place: place.into(),
            problem: problem.into(),
        }
    }

    /// A valid file of a kind that is not taken.
    pub(super) fn unsupported(
        format: Format,
        place: impl Into<String>,
        problem: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Unsupported {
            format,
            place: place.into(),
            problem: problem.into(),
            hint: hint.into(),
        }
    }

    /// Positions that the format cannot hold.
    pub(super) fn unwritable(format: Format, problem: impl Into<String>) -> Self {
        Self::Unwritable {
            format,
            problem: problem.into(),
        }
    }
}
