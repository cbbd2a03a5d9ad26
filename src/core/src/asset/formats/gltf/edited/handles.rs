//! How accessors are named while the result is being made.

/// Which accessor an attribute has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AccessorHandle {
    /// One of the file that the primitive came from.
    Old(usize),
    /// A new one.
    New(usize),
}
