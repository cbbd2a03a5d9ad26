//! The files that a document names: external buffers and images.
//!
//! A missing buffer is an error of [`buffers`](super::buffers): it holds the shape. A missing image is a warning:
//! nothing is computed from it.

use super::container;
use super::document::{GLB_FORMAT, GltfDocument};
use super::fault::GltfFault;
use super::scene::Warnings;
use super::text::{list_of, value_of};
use super::uri::{self, RelativeName};
use crate::asset::{FileSet, Format};

/// How many names a warning lists.
const MOST_LISTED: usize = 5;

/// The names of the files of buffers and images of a document, each once, in document order. None when the document
/// cannot be parsed: its reader reports why.
pub(super) fn companion_names(files: &FileSet, format: Format) -> Vec<String> {
    let bytes = if format == GLB_FORMAT {
        match container::split(&files.main, GltfFault(format)) {
            Ok(parts) => parts.json,
            Err(_) => return Vec::new(),
        }
    } else {
        &files.main[..]
    };
    let Ok(text) = std::str::from_utf8(bytes) else {
        return Vec::new();
    };
    let mut names = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    for key in ["buffers", "images"] {
        for item in list_of(text, key) {
            if let Some(RelativeName::Inside(name)) = uri_of(item).as_deref().map(uri::relative_name)
                && seen.insert(name.clone())
            {
                names.push(name);
            }
        }
    }
    names
}

/// Warns of images whose files are not among those given.
pub(super) fn warn_of_missing(doc: &GltfDocument<'_>, files: &FileSet, warnings: &mut Warnings) {
    let (mut missing, mut outside) = (Vec::new(), Vec::new());
    for (i, item) in list_of(doc.text, "images").into_iter().enumerate() {
        let Some(uri) = uri_of(item) else { continue };
        match uri::relative_name(&uri) {
            RelativeName::Inside(name) if !files.companions.contains_key(&name) => missing.push((i, name)),
            RelativeName::Outside => outside.push((i, uri)),
            _ => {}
        }
    }
    let mut warn = |code: &str, list: &[(usize, String)], what: &str| {
        let Some((first, _)) = list.first() else { return };
        let names: Vec<String> = list
            .iter()
            .take(MOST_LISTED)
            .map(|(_, name)| uri::shown(name))
            .collect();
        let more = match list.len().saturating_sub(MOST_LISTED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let message = format!("{what}: {}{more}", names.join(", "));
        warnings.push((code.into(), message, format!("images/{first}")));
    };
    warn(
        "image-missing",
        &missing,
        "images that were not sent along with the model; it comes back without them",
    );
    warn(
        "image-outside",
        &outside,
        "images outside of the model's folder are never opened; the model names them as before",
    );
}

/// The URI of a buffer or image; `None` without one, and for data that is embedded.
pub(super) fn uri_of(item: &str) -> Option<String> {
    let text = value_of(item, "uri")?;
    // An embedded picture may be large; its text is not copied.
    let is_data = |t: &str| t.get(1..6).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"));
    if is_data(text) {
        return None;
    }
    let uri: String = serde_json::from_str(text).ok()?;
    (!uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"))).then_some(uri)
}
