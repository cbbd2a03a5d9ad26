//! How accessors are named while the result is being made.

use super::super::text::json_object;
use std::collections::BTreeMap;

/// Which accessor an attribute has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AccessorHandle {
    /// One of the file that the primitive came from.
    Old(usize),
    /// A new one.
    New(usize),
}

impl AccessorHandle {
    /// Its number in a document that has so many accessors of its own.
    pub(super) fn number(self, old_accessors: usize) -> usize {
        match self {
            Self::Old(at) => at,
            Self::New(at) => old_accessors + at,
        }
    }
}

/// Attributes with the numbers of their accessors as a JSON object.
pub(super) fn attributes_text(all: &BTreeMap<String, AccessorHandle>, old_accessors: usize) -> String {
    json_object(all.iter().map(|(name, handle)| (name, handle.number(old_accessors))))
}
