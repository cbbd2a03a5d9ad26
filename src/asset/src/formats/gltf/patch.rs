//! How a plan becomes new bytes in buffers, edits of the text and appended data.

use super::accessors::ShapeAttribute;
use super::builder::{BufferBuilder, VERTICES, bounds};
use super::document::GltfDocument;
use super::patched::PatchedDocument;
use super::schema::DRACO;
use super::sharing::{AccessorOverwrite, AppendedAccessor, MeshRef, SharingPlan};
use super::targets::AttributeSlot;
use super::text::{JsonEdits, list_of, value_of};
use crate::Error;
use std::collections::{BTreeMap, BTreeSet};

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
            let bounds = is_bounded.then(|| bounds(&append.values, 3));
            new.push_floats(&append.values, slot.shape(), Some(VERTICES), bounds);
        }
        let buffer = self.doc.growing_buffer().unwrap_or(self.doc.buffers.len());
        self.append(&new, &format!("buffer {buffer}"))
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
