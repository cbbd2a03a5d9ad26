//! The files that a document names, and how an edited document becomes files: in the container that it came in or in the other one.
//!
//! The files that a document names: external buffers and images.
//!
//! A missing buffer is an error of [`buffers`](super::buffers): it holds the shape. A missing image is a warning:
//! nothing is computed from it.

use super::buffers::{self, RelativeName, media_type_of};
use super::builder::{BufferBuilder, embedded_buffer_text};
use super::container::{self, GltfFault};
use super::document::{GLB_FORMAT, GltfDocument};
use super::patched::PatchedDocument;
use super::scene::Warnings;
use super::schema::MESHOPT;
use super::stored::BufferOrigin;
use super::text::{JsonEdits, index_of, list_of, quoted, value_of, with_member, without_keys};
use crate::{Error, FileSet, Format, WrittenFiles};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Writes the files.
pub(super) fn package(
    files: &FileSet,
    patched: PatchedDocument<'_, '_>,
    format: Format,
) -> Result<WrittenFiles, Error> {
    let PatchedDocument {
        doc,
        mut edits,
        buffers: mut changed,
        added_buffer,
    } = patched;
    let mut companions = files.owned_companions();
    if edits.is_empty() && changed.is_empty() && format == doc.fault.0 {
        return Ok(WrittenFiles::from_upload(files));
    }

    let mut bin: Option<Cow<'_, [u8]>> = None;
    for (i, origin) in doc.origins().enumerate() {
        let text = doc.item(&doc.buffers, i);
        let stored = doc.buffer_bytes(i);
        let declared = doc.buffers.values[i].byte_length.index();
        let new = changed.remove(&i);
        let becomes_bin = i == 0 && format == GLB_FORMAT && (doc.container.is_none() || *origin == BufferOrigin::Bin);
        if becomes_bin {
            let Some(bytes) = stored else {
                let problem = "buffer 0 holds no bytes, and in a GLB it would have to be the BIN chunk";
                return Err(GltfFault(format).unwritable(problem));
            };
            if doc.container.is_none() {
                edits.remove(text, "uri");
                if let BufferOrigin::Companion(name) = origin
                    && doc.is_exclusive(i)
                {
                    companions.remove(name);
                }
            }
            // What a file has beyond the declared length belongs to nothing, but a BIN chunk is kept as it came.
            let mut now = new.map_or(Cow::Borrowed(&bytes[..]), Cow::Owned);
            if doc.container.is_none() {
                now = declared_part(now, bytes.len(), declared);
            }
            bin = Some(now);
            continue;
        }
        match (origin, new) {
            // Only on the way from GLB to glTF: the chunk becomes an embedded buffer.
            (BufferOrigin::Bin, new) => {
                let bytes = stored.map_or(&[][..], |bytes| bytes);
                let now = new.map_or(Cow::Borrowed(bytes), Cow::Owned);
                let now = declared_part(now, bytes.len(), declared);
                edits.set(text, "uri", quoted(&buffers::embed(&now)));
            }
            (BufferOrigin::Embedded, Some(new)) => edits.set(text, "uri", quoted(&buffers::embed(&new))),
            (BufferOrigin::Companion(name), Some(new)) => drop(companions.insert(name.clone(), new)),
            (_, _) => {}
        }
    }
    if let Some(bytes) = added_buffer {
        edits.push_or_set(
            doc.text,
            "buffers",
            doc.array(&doc.buffers),
            &[embedded_buffer_text(&bytes)],
        );
    }
    let json = edits.apply();
    let main = if format == GLB_FORMAT {
        // A chunk that no buffer refers to is kept all the same.
        let bin = bin.as_deref().or(doc.chunk());
        doc.join(json.trim_end(), bin, GltfFault(format))?
    } else {
        json.into_bytes()
    };
    Ok(WrittenFiles::of(main, companions))
}

/// A buffer's bytes without what lies beyond its length. One that has grown has a new length: all of it.
fn declared_part(now: Cow<'_, [u8]>, stored: usize, declared: usize) -> Cow<'_, [u8]> {
    let kept = if now.len() > stored {
        now.len()
    } else {
        declared.min(now.len())
    };
    match now {
        Cow::Borrowed(bytes) => Cow::Borrowed(&bytes[..kept]),
        Cow::Owned(mut bytes) => {
            bytes.truncate(kept);
            Cow::Owned(bytes)
        }
    }
}

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
            if let Some(RelativeName::Inside(name)) = uri_of(item).as_deref().map(buffers::relative_name)
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
        match buffers::relative_name(&uri) {
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
            .map(|(_, name)| buffers::shown(name))
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

/// Moves the buffers and images of a written GLB that lie in companions into its binary chunk. An image of a kind that
/// glTF has no media type for stays a companion, and so does every file that nothing names.
pub(super) fn embed_companions(written: WrittenFiles, fault: GltfFault) -> Result<WrittenFiles, Error> {
    if written.companions.is_empty() {
        return Ok(written);
    }
    let WrittenFiles {
        main,
        mut companions,
        followed,
        warnings,
    } = written;
    let parts = container::split(&main, fault)?;
    let Ok(text) = std::str::from_utf8(parts.json) else {
        return Err(fault.unwritable("the document is not UTF-8"));
    };
    let mut embedder = CompanionEmbedder {
        text,
        edits: JsonEdits::new(text),
        bin: parts.bin.unwrap_or_default().to_vec(),
        companions: &companions,
        taken: Vec::new(),
    };
    embedder.embed_buffers();
    embedder.embed_images();
    let CompanionEmbedder {
        mut edits, bin, taken, ..
    } = embedder;
    if taken.is_empty() {
        drop(parts);
        return Ok(WrittenFiles {
            main,
            companions,
            followed,
            warnings,
        });
    }
    if let Some(first) = list_of(text, "buffers").first() {
        edits.set(first, "byteLength", bin.len());
    }
    let json = edits.apply();
    let main = container::join(json.trim_end(), Some(&bin), &parts.rest, fault)?;
    taken.iter().for_each(|name| drop(companions.remove(name)));
    Ok(WrittenFiles {
        main,
        companions,
        followed,
        warnings,
    })
}

struct CompanionEmbedder<'a> {
    text: &'a str,
    edits: JsonEdits<'a>,
    /// The binary chunk so far.
    bin: Vec<u8>,
    companions: &'a BTreeMap<String, Vec<u8>>,
    /// Companions that are in the chunk now.
    taken: Vec<String>,
}

impl<'a> CompanionEmbedder<'a> {
    /// The companion that an item names.
    fn companion_of(&self, item: &str) -> Option<(String, &'a [u8])> {
        match buffers::relative_name(&uri_of(item)?) {
            RelativeName::Inside(name) => {
                let bytes = self.companions.get(&name)?;
                Some((name, bytes))
            }
            _ => None,
        }
    }

    /// Adds bytes to the chunk; answers where they begin.
    fn append_companion(&mut self, name: String, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let at = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.taken.push(name);
        at
    }

    /// Appends external buffers to the first one; views follow them.
    fn embed_buffers(&mut self) {
        let buffers = list_of(self.text, "buffers");
        // For each buffer its new number, and where it begins there.
        let mut moved = Vec::with_capacity(buffers.len());
        let mut kept = Vec::new();
        for (i, item) in buffers.iter().enumerate() {
            let declared = index_of(item, "byteLength").unwrap_or(0);
            match self.companion_of(item) {
                // The first buffer is the chunk; a file that is shorter than it says was refused when it was read.
                Some((name, bytes)) if i > 0 && bytes.len() >= declared => {
                    let at = self.append_companion(name, &bytes[..declared]);
                    moved.push((0, at));
                }
                _ => {
                    moved.push((kept.len(), 0));
                    kept.push(i);
                }
            }
        }
        if kept.len() == buffers.len() {
            return;
        }
        for item in buffers
            .iter()
            .enumerate()
            .filter(|(i, _)| !kept.contains(i))
            .map(|(_, item)| item)
        {
            self.edits.remove_item(item);
        }
        for view in list_of(self.text, "bufferViews") {
            self.move_reference(view, &moved);
            let extensions = value_of(view, "extensions").unwrap_or("{}");
            MESHOPT
                .iter()
                .filter_map(|name| value_of(extensions, name))
                .for_each(|inner| self.move_reference(inner, &moved));
        }
    }

    /// Renumbers the buffer of a view, or of its compressed form.
    fn move_reference(&mut self, object: &'a str, moved: &[(usize, usize)]) {
        let Some(buffer) = index_of(object, "buffer") else {
            return;
        };
        let Some(&(number, at)) = moved.get(buffer) else { return };
        if number != buffer {
            self.edits.set(object, "buffer", number);
        }
        if at > 0 {
            let offset = index_of(object, "byteOffset").unwrap_or(0);
            self.edits.set(object, "byteOffset", at + offset);
        }
    }

    /// Gives every image that lies in a companion a view of its own.
    fn embed_images(&mut self) {
        let mut pictures = BufferBuilder::default();
        let first = list_of(self.text, "bufferViews").len();
        // Images that name one file share one view.
        let mut view_of: BTreeMap<String, usize> = BTreeMap::new();
        for image in list_of(self.text, "images") {
            let Some((name, bytes)) = self.companion_of(image) else {
                continue;
            };
            let Some(media_type) = media_type_of(&name, bytes) else {
                continue;
            };
            let view = match view_of.get(&name) {
                Some(view) => *view,
                None => {
                    let view = first + pictures.add_view(bytes, None);
                    self.taken.push(name.clone());
                    view_of.insert(name, view);
                    view
                }
            };
            let text = with_member(&without_keys(image, &["uri"]), "bufferView", view);
            self.edits
                .replace(image, with_member(&text, "mimeType", quoted(media_type)));
        }
        if pictures.is_empty() {
            return;
        }
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let views = pictures.view_texts(0, self.bin.len());
        self.bin.extend_from_slice(pictures.bytes());
        let array = value_of(self.text, "bufferViews");
        self.edits.push_or_set(self.text, "bufferViews", array, &views);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Format;

    #[test]
    fn buffers_and_images_move_into_the_chunk_and_views_follow() {
        let json = concat!(
            r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":3},{"byteLength":2,"uri":"b%20c.bin"},"#,
            r#"{"byteLength":1,"uri":"data:application/octet-stream;base64,AA=="},{"byteLength":4,"uri":"d.bin"}],"#,
            r#""bufferViews":[{"buffer":0,"byteLength":3},{"buffer":1,"byteOffset":1,"byteLength":1},"#,
            r#"{"buffer":2,"byteLength":1},{"byteLength":4,"buffer":3}],"#,
            r#""images":[{"uri":"i.png","name":"i"},{"uri":"i.png"},{"uri":"odd.xyz"},{"uri":"gone.png"}]}"#
        );
        let fault = GltfFault(Format::GLB);
        let main = container::join(json, Some(&[1, 2, 3]), &[], fault).expect("small");
        let companion = |name: &str, bytes: &[u8]| (name.to_owned(), bytes.to_vec());
        let companions = BTreeMap::from([
            companion("b c.bin", &[4, 5, 6]),
            companion("d.bin", &[7; 4]),
            companion("i.png", b"\x89PNG\r\n\x1a\n!"),
            companion("odd.xyz", b"?"),
            companion("no-media.txt", b"text"),
        ]);
        let written = embed_companions(WrittenFiles::of(main, companions), fault).expect("fits");
        let left: Vec<&String> = written.companions.keys().collect();
        assert_eq!(left, ["no-media.txt", "odd.xyz"]);
        let parts = container::split(&written.main, fault).expect("valid");
        let document: serde_json::Value = serde_json::from_slice(parts.json).expect("JSON");
        let bin = parts.bin.expect("a chunk");
        assert_eq!(document["buffers"].as_array().map(Vec::len), Some(2));
        assert_eq!(document["buffers"][0]["byteLength"], 21);
        let bytes_of = |view: usize| {
            let view = &document["bufferViews"][view];
            let at = view["byteOffset"].as_u64().unwrap_or(0) as usize;
            &bin[at..at + view["byteLength"].as_u64().expect("a length") as usize]
        };
        assert_eq!((bytes_of(0), bytes_of(1)), (&[1u8, 2, 3][..], &[5u8][..]));
        assert_eq!(document["bufferViews"][2]["buffer"], 1);
        assert_eq!((bytes_of(3), bytes_of(4)), (&[7u8; 4][..], &b"\x89PNG\r\n\x1a\n!"[..]));
        let image = serde_json::json!({"name": "i", "bufferView": 4, "mimeType": "image/png"});
        assert_eq!(document["images"][0], image);
        assert_eq!(document["images"][1]["bufferView"], 4);
        assert_eq!(document["images"][2]["uri"], "odd.xyz");
        assert_eq!(document["images"][3]["uri"], "gone.png");
    }
}
