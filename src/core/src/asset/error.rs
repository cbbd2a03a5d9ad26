//! Why a model cannot be read or written.

use super::Format;

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

    /// Positions that the format cannot hold.
    pub(super) fn unwritable(format: Format, problem: impl Into<String>) -> Self {
        Self::Unwritable {
            format,
            problem: problem.into(),
        }
    }
}
