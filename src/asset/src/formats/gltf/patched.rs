//! A document with changes that leave every other byte alone: new bytes in buffers, edits of the text, appended data.

use super::builder::{BufferBuilder, bounds};
use super::document::GltfDocument;
use super::text::{JsonEdits, value_of};
use crate::Error;
use std::collections::BTreeMap;

/// A document with its edits, and the buffers that differ from the stored ones.
pub(super) struct PatchedDocument<'d, 'a> {
    pub(super) doc: &'d GltfDocument<'a>,
    pub(super) edits: JsonEdits<'a>,
    /// Whole new contents by buffer.
    pub(super) buffers: BTreeMap<usize, Vec<u8>>,
    /// Contents of a buffer that has to be added because no other takes new data.
    pub(super) added_buffer: Option<Vec<u8>>,
}

impl<'d, 'a> PatchedDocument<'d, 'a> {
    /// Nothing is changed yet.
    pub(super) fn new(doc: &'d GltfDocument<'a>) -> Self {
        Self {
            doc,
            edits: JsonEdits::new(doc.text),
            buffers: BTreeMap::new(),
            added_buffer: None,
        }
    }

    /// A buffer's bytes, made our own on first use.
    fn own_bytes(&mut self, buffer: usize) -> &mut Vec<u8> {
        let stored = self.doc.buffer_bytes(buffer);
        self.buffers
            .entry(buffer)
            .or_insert_with(|| stored.map(|b| b.to_vec()).unwrap_or_default())
    }

    /// Writes elements of floats over the bytes of a view, of which element 0 begins at `offset`. `None` where one has no place.
    pub(super) fn overwrite<'v>(
        &mut self,
        view: usize,
        offset: u64,
        stride: u64,
        elements: impl Iterator<Item = (Option<usize>, &'v [f32])>,
    ) -> Option<()> {
        let view = self.doc.views.get(view)?;
        let (start, stride) = ((view.offset() + offset) as usize, stride as usize);
        let bytes = self.own_bytes(view.buffer.index());
        for (i, element) in elements {
            let place = bytes.get_mut(start + i? * stride..)?.get_mut(..4 * element.len())?;
            let numbers = place.as_chunks_mut::<4>().0.iter_mut().zip(element);
            numbers.for_each(|(to, v)| *to = v.to_le_bytes());
        }
        Some(())
    }

    /// Gives an accessor the bounds of these values. Only positions must have bounds, but bounds that are there must be right.
    pub(super) fn set_bounds(&mut self, accessor: usize, values: &[f32], lanes: usize, is_position: bool) {
        let text = self.doc.item(&self.doc.accessors, accessor);
        let (least, most) = bounds(values, lanes);
        for (key, value) in [("min", least), ("max", most)] {
            if is_position || value_of(text, key).is_some() {
                self.edits.set(text, key, &value);
            }
        }
    }

    /// Adds new data to the end of the first buffer that takes more, or to a new one. `name` is what an error calls it.
    pub(super) fn append(&mut self, new: &BufferBuilder, name: &str) -> Result<(), Error> {
        if new.is_empty() {
            return Ok(());
        }
        let doc = self.doc;
        let target = doc.growing_buffer();
        let mut bytes = target.map_or_else(Vec::new, |i| std::mem::take(self.own_bytes(i)));
        let buffer = target.unwrap_or(doc.buffers.len());
        let views = new.append_bytes(&mut bytes, buffer, name, doc.fault)?;
        self.edits
            .push_or_set(doc.text, "bufferViews", doc.array(&doc.views), &views);
        let accessors = new.accessor_texts(doc.views.len());
        self.edits
            .push_or_set(doc.text, "accessors", doc.array(&doc.accessors), &accessors);
        self.grow(target, bytes);
        Ok(())
    }

    /// Gives a buffer more bytes than it had; `None`: a new one.
    pub(super) fn grow(&mut self, buffer: Option<usize>, bytes: Vec<u8>) {
        let Some(i) = buffer else {
            self.added_buffer = Some(bytes);
            return;
        };
        let item = self.doc.item(&self.doc.buffers, i);
        self.edits.set(item, "byteLength", bytes.len());
        self.buffers.insert(i, bytes);
    }
}
