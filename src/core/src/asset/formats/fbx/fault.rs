//! What FBX is known by, and the ways to say what is wrong with a file.

use crate::asset::format::{FormatDetails, Recognition};
use crate::asset::{Error, Format};

/// FBX, by what it is known.
pub(in super::super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "fbx",
    media_types: &["application/vnd.autodesk.fbx", "model/fbx", "application/fbx"],
    recognise: |bytes| {
        let begins = |mark: &[u8]| bytes.starts_with(mark);
        Recognition::mark(begins(b"Kaydara FBX Binary") || begins(b"; FBX") || begins(b"FBXHeaderExtension"))
    },
});

/// The refusal of a file at a place.
pub(super) fn refuse(place: impl Into<String>, problem: impl Into<String>) -> Error {
    Error::malformed(FORMAT, place, problem)
}

/// An element as texts name it.
pub(super) fn place_of(kind: &str, element: &ufbx::Element) -> String {
    format!("{kind} {} \"{}\"", element.typed_id, &*element.name)
}
