//! Indices in JSON text.

use super::super::schema::WholeNumber;
use super::super::text;

/// The index that an object has under a key.
pub(super) fn member_index(object: &str, key: &str) -> Option<usize> {
    text::value_of(object, key).and_then(parse_index)
}

pub(super) fn parse_index(json: &str) -> Option<usize> {
    serde_json::from_str::<WholeNumber>(json).ok().map(WholeNumber::index)
}
