//! Short ways to say what is wrong with a glTF file.

use crate::asset::{Error, Format};

/// Makes the errors of one file, which all name its format.
#[derive(Debug, Clone, Copy)]
pub(super) struct GltfFault(pub(super) Format);

impl GltfFault {
    /// The file breaks a rule of the format at `place`.
    pub(super) fn malformed(self, place: impl Into<String>, problem: impl Into<String>) -> Error {
        Error::Malformed {
            format: self.0,
            place: place.into(),
            problem: problem.into(),
        }
    }

    /// The file is valid but not for us.
    pub(super) fn unsupported(
        self,
        place: impl Into<String>,
        problem: impl Into<String>,
        hint: impl Into<String>,
    ) -> Error {
        Error::Unsupported {
            format: self.0,
            place: place.into(),
            problem: problem.into(),
            hint: hint.into(),
        }
    }

    /// The result cannot be written.
    pub(super) fn unwritable(self, problem: impl Into<String>) -> Error {
        Error::Unwritable {
            format: self.0,
            problem: problem.into(),
        }
    }
}
