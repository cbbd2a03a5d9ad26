//! A document with changes that leave every other byte alone: new bytes in buffers, edits of the text, appended data; and how a
//! plan becomes such changes.

use super::accessors::ShapeAttribute;
use super::builder::{BufferBuilder, NewAccessor, VERTICES, bounds, float_bytes};
use super::document::GltfDocument;
use super::schema::DRACO;
use super::sharing::{AccessorOverwrite, AppendedAccessor, MeshRef, SharingPlan};
use super::targets::AttributeSlot;
use super::text::{JsonEdits, list_of, value_of};
use crate::Error;
use std::collections::{BTreeMap, BTreeSet};

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

    /// Adds new data to the end of the first buffer that takes more, or to a new one.
    pub(super) fn append(&mut self, new: &BufferBuilder) -> Result<(), Error> {
        if new.is_empty() {
            return Ok(());
        }
        let doc = self.doc;
        let target = doc.growing_buffer();
        let mut bytes = target.map_or_else(Vec::new, |i| std::mem::take(self.own_bytes(i)));
        let views = new.append_bytes(&mut bytes, target.unwrap_or(doc.buffers.len()), doc.fault)?;
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

/// Makes the changes of a plan.
pub(super) fn patch<'d, 'a>(doc: &'d GltfDocument<'a>, plan: &SharingPlan) -> Result<PatchedDocument<'d, 'a>, Error> {
    let mut patched = PatchedDocument::new(doc);
    if !plan.is_empty() {
        for overwrite in &plan.overwrites {
            patched.overwrite_changed(overwrite)?;
        }
        patched.append_accessors(&plan.appends)?;
        patched.patch_meshes(plan)?;
    }
    Ok(patched)
}

/// Bytes of JSON that copies of meshes may take: a mesh is described once in a file, but may be placed any number of times.
const MOST_COPIED: usize = 512 << 20;

impl<'a> PatchedDocument<'_, 'a> {
    fn overwrite_changed(&mut self, overwrite: &AccessorOverwrite) -> Result<(), Error> {
        let AccessorOverwrite {
            accessor,
            slot,
            channel,
            sparse,
        } = overwrite;
        let described = &self.doc.accessors.values[*accessor];
        // Sparse values are packed.
        let place = match (sparse, &described.sparse, self.doc.layout(*accessor)) {
            (Some(_), Some(s), Some(l)) => Some((s.values.buffer_view, s.values.byte_offset.0, l.element)),
            (None, _, Some(l)) => described.buffer_view.map(|view| (view, described.offset(), l.stride)),
            _ => None,
        };
        let Some((view, offset, stride)) = place else {
            return Ok(());
        };
        let elements = channel.values.chunks_exact(slot.lanes()).zip(&channel.changed);
        let changed = elements.enumerate().filter(|(_, (_, changed))| **changed);
        let in_place = changed.map(|(i, (element, _))| {
            let replaced = sparse.as_ref().map(|replaced| replaced.binary_search(&i));
            (replaced.map_or(Some(i), Result::ok), element)
        });
        let written = self.overwrite(view.index(), offset, stride, in_place);
        written.ok_or_else(|| {
            let problem = "reaches past the end of its buffer";
            self.doc.fault.malformed(format!("accessors/{accessor}"), problem)
        })?;
        let is_position = slot.role == ShapeAttribute::Position;
        self.set_bounds(*accessor, &channel.values, slot.lanes(), is_position);
        Ok(())
    }

    /// Adds accessors, each with a view of its own.
    fn append_accessors(&mut self, appends: &[AppendedAccessor]) -> Result<(), Error> {
        let mut new = BufferBuilder::default();
        for append in appends {
            let Some((_, _, slot)) = append.users.first() else {
                continue;
            };
            let is_bounded = slot.role == ShapeAttribute::Position;
            let accessor = NewAccessor {
                bounds: is_bounded.then(|| bounds(&append.values, 3)),
                ..NewAccessor::of(5126, append.values.len() / slot.lanes(), slot.shape())
            };
            new.push_packed(&float_bytes(&append.values), Some(VERTICES), accessor);
        }
        self.append(&new)
    }

    /// Points attributes at new accessors, in place or in copies of their meshes, and nodes at the copies.
    fn patch_meshes(&mut self, plan: &SharingPlan) -> Result<(), Error> {
        let doc = self.doc;
        let mesh_text = |index: usize| doc.item(&doc.meshes, index);
        let copied: usize = plan.copies.iter().map(|copy| mesh_text(copy.of).len()).sum();
        if copied > MOST_COPIED {
            let problem = format!(
                "{} instances would need {copied} bytes of JSON, at most {MOST_COPIED} are written",
                plan.copies.len()
            );
            return Err(doc.fault.unwritable(problem));
        }
        let mut changes: BTreeMap<MeshRef, MeshChanges> = BTreeMap::new();
        for (i, append) in plan.appends.iter().enumerate() {
            for &(mesh, primitive, slot) in &append.users {
                let redirect = (primitive, slot, doc.accessors.len() + i);
                changes.entry(mesh).or_default().redirects.push(redirect);
            }
        }
        for &(mesh, primitive) in &plan.stale_draco {
            changes.entry(mesh).or_default().stale.insert(primitive);
        }
        for (mesh, changes) in &changes {
            if let MeshRef::Original(index) = mesh {
                changes.edit(&mut self.edits, mesh_text(*index));
            }
        }
        let mut copies = Vec::new();
        for (i, copy) in plan.copies.iter().enumerate() {
            let mut edits = JsonEdits::new(mesh_text(copy.of));
            if let Some(changes) = changes.get(&MeshRef::Copy(i)) {
                changes.edit(&mut edits, mesh_text(copy.of));
            }
            copies.push(edits.apply());
            for &node in &copy.nodes {
                self.edits.set(doc.item(&doc.nodes, node), "mesh", doc.meshes.len() + i);
            }
        }
        self.edits
            .push_or_set(doc.text, "meshes", doc.array(&doc.meshes), &copies);
        Ok(())
    }
}

/// What becomes of a mesh.
#[derive(Default)]
struct MeshChanges {
    /// Attributes of primitives with their new accessors.
    redirects: Vec<(usize, AttributeSlot, usize)>,
    /// Primitives whose Draco copy is stale.
    stale: BTreeSet<usize>,
}

impl MeshChanges {
    fn edit<'a>(&self, edits: &mut JsonEdits<'a>, mesh: &'a str) {
        let primitives = list_of(mesh, "primitives");
        for (primitive, slot, accessor) in &self.redirects {
            let primitive = primitives.get(*primitive).copied().unwrap_or_default();
            let attributes = match slot.target {
                None => value_of(primitive, "attributes"),
                Some(target) => list_of(primitive, "targets").get(target).copied(),
            };
            if let Some(attributes) = attributes {
                edits.set(attributes, slot.role.name(), accessor);
            }
        }
        for primitive in self.stale.iter().filter_map(|p| primitives.get(*p)) {
            edits.remove_extension(primitive, DRACO);
        }
    }
}
