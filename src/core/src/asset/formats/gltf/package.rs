//! From an edited document to files, in the container that it came in or in the other one.

use super::buffers::{BufferBytes, BufferOrigin};
use super::builder::embedded_buffer_text;
use super::document::{GLB_FORMAT, GltfDocument, PatchedDocument};
use super::fault::GltfFault;
use super::text::quoted;
use super::{container, uri};
use crate::asset::{Error, FileSet, Format, WrittenFiles};
use std::borrow::Cow;

/// Writes the files.
pub(super) fn package(
    doc: &GltfDocument<'_>,
    files: &FileSet,
    buffers: &BufferBytes,
    patched: PatchedDocument<'_>,
    format: Format,
) -> Result<WrittenFiles, Error> {
    let PatchedDocument {
        mut edits,
        buffers: mut changed,
        added_buffer,
    } = patched;
    let mut companions = files.owned_companions();
    if edits.is_empty() && changed.is_empty() && format == doc.fault.0 {
        return Ok(WrittenFiles::from_upload(files));
    }

    let mut bin: Option<Cow<'_, [u8]>> = None;
    for (i, stored) in buffers.stored.iter().enumerate() {
        let text = doc.buffers.items[i];
        let new = changed.remove(&i);
        let becomes_bin =
            i == 0 && format == GLB_FORMAT && (doc.container.is_none() || stored.origin == BufferOrigin::Bin);
        if becomes_bin {
            let Some(bytes) = &stored.bytes else {
                let problem = "buffer 0 holds no bytes, and in a GLB it would have to be the BIN chunk";
                return Err(GltfFault(format).unwritable(problem));
            };
            if doc.container.is_none() {
                edits.remove(text, "uri");
                if let BufferOrigin::Companion(name) = &stored.origin
                    && buffers.is_exclusive(i)
                {
                    companions.remove(name);
                }
            }
            // What a file has beyond the declared length is nobody's, but a BIN chunk is kept as it came.
            let mut now = new.map_or(Cow::Borrowed(&bytes[..]), Cow::Owned);
            if doc.container.is_none() {
                now = declared_part(now, bytes.len(), doc.buffers.values[i].byte_length.index());
            }
            bin = Some(now);
            continue;
        }
        match (&stored.origin, new) {
            // Only on the way from GLB to glTF: the chunk becomes an embedded buffer.
            (BufferOrigin::Bin, new) => {
                let bytes = stored.bytes.as_deref().unwrap_or_default();
                let now = new.map_or(Cow::Borrowed(bytes), Cow::Owned);
                let now = declared_part(now, bytes.len(), doc.buffers.values[i].byte_length.index());
                edits.set(text, "uri", quoted(&uri::embed(&now)));
            }
            (BufferOrigin::Embedded, Some(new)) => edits.set(text, "uri", quoted(&uri::embed(&new))),
            (BufferOrigin::Companion(name), Some(new)) => drop(companions.insert(name.clone(), new)),
            (_, _) => {}
        }
    }
    if let Some(bytes) = added_buffer {
        edits.push_or_set(doc.text, "buffers", doc.buffers.text, &[embedded_buffer_text(&bytes)]);
    }
    let json = edits.apply();
    let main = if format == GLB_FORMAT {
        let rest = doc.container.as_ref().map_or(&[][..], |c| &c.rest);
        // A chunk that no buffer refers to is kept all the same.
        let unused = doc.container.as_ref().and_then(|c| c.bin);
        container::join(json.trim_end(), bin.as_deref().or(unused), rest, GltfFault(format))?
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
