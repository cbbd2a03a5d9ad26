//! Which mesh is meant, one that is there or one to be appended.

/// A mesh of the document, or the n-th copy to be appended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in super::super) enum MeshRef {
    Original(usize),
    Copy(usize),
}
