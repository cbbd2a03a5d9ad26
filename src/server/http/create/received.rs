//! What an upload brought.

use crate::asset::FileSet;
use crate::server::uploads::Held;

/// Files of an upload, which count as under way until dropped.
pub(super) struct Received {
    pub(super) files: FileSet,
    pub(super) held: Option<Held>,
}
