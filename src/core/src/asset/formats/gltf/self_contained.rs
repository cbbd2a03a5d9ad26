//! A GLB that needs no other file: what companions hold moves into its binary chunk.

use super::builder::BufferBuilder;
use super::companions::uri_of;
use super::container;
use super::fault::GltfFault;
use super::media_type::media_type_of;
use super::text::{JsonEdits, index_of, list_of, quoted, value_of};
use super::uri::{self, RelativeName};
use crate::asset::{Error, WrittenFiles};
use std::collections::BTreeMap;

/// Names of the extensions that name a buffer inside of a view.
pub(super) const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

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
        match uri::relative_name(&uri_of(item)?) {
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
            let mut own = JsonEdits::new(image);
            own.remove(image, "uri");
            let mut text = own.apply();
            for (key, json) in [("bufferView", view.to_string()), ("mimeType", quoted(media_type))] {
                let mut own = JsonEdits::new(&text);
                own.set(&text, key, &json);
                text = own.apply();
            }
            self.edits.replace(image, text);
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
    use crate::asset::Format;

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
