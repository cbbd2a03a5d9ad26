//! The other model that an edit takes.

use crate::asset::{FileSet, Format};

/// Another model, whose files come with the edit or are those of a session.
#[derive(Debug, Clone, Default)]
pub struct OtherModel {
    /// Its files.
    pub files: FileSet,
    /// Whether it is that of a session, for the words of errors alone.
    pub from_session: bool,
    /// Its format; `None`: detected by its first bytes.
    pub format: Option<Format>,
}
