//! Carries out a plan: new bytes in buffers, and edits of the document's text.

use super::accessors::{AccessorLayout, ShapeAttribute};
use super::buffers::BufferBytes;
use super::builder::{BufferBuilder, NewAccessor, VERTICES, bounds, float_bytes};
use super::document::{GltfDocument, PatchedDocument};
use super::schema::DRACO;
use super::sharing::{AccessorOverwrite, AppendedAccessor, MeshRef, SharingPlan};
use super::targets::AttributeSlot;
use super::text::{JsonEdits, items, list_of, value_of};
use crate::Error;
use std::collections::{BTreeMap, BTreeSet};

/// Makes the changes of a plan.
pub(super) fn patch<'a>(
    doc: &GltfDocument<'a>,
    buffers: &BufferBytes,
    plan: SharingPlan,
) -> Result<PatchedDocument<'a>, Error> {
    let mut patcher = DocumentPatcher {
        doc,
        stored: buffers,
        out: PatchedDocument {
            edits: JsonEdits::new(doc.text),
            buffers: BTreeMap::new(),
            added_buffer: None,
        },
    };
    if !plan.is_empty() {
        for overwrite in &plan.overwrites {
            patcher.overwrite(overwrite)?;
        }
        patcher.append(&plan.appends)?;
        patcher.patch_meshes(&plan)?;
    }
    Ok(patcher.out)
}

/// Bytes of JSON that copies of meshes may take: a mesh is described once in a file, but may be placed any number of times.
const MOST_COPIED: usize = 512 << 20;

struct DocumentPatcher<'d, 'a> {
    doc: &'d GltfDocument<'a>,
    stored: &'d BufferBytes<'d>,
    out: PatchedDocument<'a>,
}

impl<'a> DocumentPatcher<'_, 'a> {
    /// A buffer's bytes, made our own on first use.
    fn patch_bytes(&mut self, buffer: usize) -> &mut Vec<u8> {
        self.out.buffers.entry(buffer).or_insert_with(|| {
            self.stored
                .stored
                .get(buffer)
                .and_then(|s| s.bytes.as_ref())
                .map(|b| b.to_vec())
                .unwrap_or_default()
        })
    }

    fn overwrite(&mut self, overwrite: &AccessorOverwrite) -> Result<(), Error> {
        let AccessorOverwrite {
            accessor,
            slot,
            channel,
            sparse,
        } = overwrite;
        let described = &self.doc.accessors.values[*accessor];
        let layout = AccessorLayout::of(described, self.doc.views.values);
        // Sparse values are packed.
        let place = match (sparse, &described.sparse, layout) {
            (Some(_), Some(s), Some(l)) => Some((s.values.buffer_view, s.values.byte_offset.0, l.element)),
            (None, _, Some(l)) => described.buffer_view.map(|view| (view, described.offset(), l.stride)),
            _ => None,
        };
        let Some((view, offset, stride)) = place else {
            return Ok(());
        };
        let Some(view) = self.doc.views.get(view.index()) else {
            return Ok(());
        };
        let outside = || {
            self.doc
                .fault
                .malformed(format!("accessors/{accessor}"), "reaches past the end of its buffer")
        };
        let (start, stride) = ((view.offset() + offset) as usize, stride as usize);
        let bytes = self.patch_bytes(view.buffer.index());
        let elements = channel
            .values
            .chunks_exact(slot.lanes())
            .zip(&channel.changed)
            .enumerate();
        for (i, (element, _)) in elements.filter(|(_, (_, changed))| **changed) {
            let i = match sparse {
                Some(replaced) => replaced.binary_search(&i).map_err(|_| outside())?,
                None => i,
            };
            let place = bytes
                .get_mut(start + i * stride..)
                .and_then(|b| b.get_mut(..4 * element.len()));
            let place = place.ok_or_else(outside)?;
            place
                .as_chunks_mut::<4>()
                .0
                .iter_mut()
                .zip(element)
                .for_each(|(to, v)| *to = v.to_le_bytes());
        }
        let text = self.doc.accessors.items[*accessor];
        let (least, most) = bounds(&channel.values, slot.lanes());
        for (key, value) in [("min", least), ("max", most)] {
            // Only POSITION must have bounds, but bounds that are there must be right.
            if slot.role == ShapeAttribute::Position || value_of(text, key).is_some() {
                self.out.edits.set(text, key, &value);
            }
        }
        Ok(())
    }

    /// Adds accessors, each with a view of its own, to the end of the first buffer that takes more.
    fn append(&mut self, appends: &[AppendedAccessor]) -> Result<(), Error> {
        if appends.is_empty() {
            return Ok(());
        }
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
        let target = self.stored.growing_buffer(self.doc);
        let stored = target.and_then(|i| self.stored.stored[i].bytes.as_ref());
        let kept = stored.map_or(0, |bytes| bytes.len().next_multiple_of(4));
        let name = format!("buffer {}", target.unwrap_or(self.doc.buffers.len()));
        new.check_size(kept, &name, self.doc.fault)?;
        new.append_to(self.doc, self.stored, &mut self.out)
    }

    /// Points attributes at new accessors, in place or in copies of their meshes, and nodes at the copies.
    fn patch_meshes(&mut self, plan: &SharingPlan) -> Result<(), Error> {
        let copied: usize = plan
            .copies
            .iter()
            .map(|copy| self.doc.meshes.items[copy.of].len())
            .sum();
        if copied > MOST_COPIED {
            let problem = format!(
                "{} instances would need {copied} bytes of JSON, at most {MOST_COPIED} are written",
                plan.copies.len()
            );
            return Err(self.doc.fault.unwritable(problem));
        }
        let first_accessor = self.doc.accessors.len();
        let mut redirects: BTreeMap<MeshRef, Vec<(usize, AttributeSlot, usize)>> = BTreeMap::new();
        for (i, append) in plan.appends.iter().enumerate() {
            for &(mesh, primitive, slot) in &append.users {
                redirects
                    .entry(mesh)
                    .or_default()
                    .push((primitive, slot, first_accessor + i));
            }
        }
        let stale = |mesh: MeshRef| {
            plan.stale_draco
                .iter()
                .filter(move |(m, _)| *m == mesh)
                .map(|(_, p)| *p)
        };
        let originals: BTreeSet<MeshRef> = redirects
            .keys()
            .copied()
            .chain(plan.stale_draco.iter().map(|(mesh, _)| *mesh))
            .filter(|mesh| matches!(mesh, MeshRef::Original(_)))
            .collect();
        for mesh in originals {
            let MeshRef::Original(index) = mesh else { continue };
            let changes = redirects.get(&mesh).map_or(&[][..], Vec::as_slice);
            edit_mesh(&mut self.out.edits, self.doc.meshes.items[index], changes, stale(mesh));
        }
        let mut copies = Vec::new();
        for (i, copy) in plan.copies.iter().enumerate() {
            let text = self.doc.meshes.items[copy.of];
            let mut edits = JsonEdits::new(text);
            let changes = redirects.get(&MeshRef::Copy(i)).map_or(&[][..], Vec::as_slice);
            edit_mesh(&mut edits, text, changes, stale(MeshRef::Copy(i)));
            copies.push(edits.apply());
            for &node in &copy.nodes {
                let index = (self.doc.meshes.len() + i).to_string();
                self.out.edits.set(self.doc.nodes.items[node], "mesh", &index);
            }
        }
        self.out
            .edits
            .push_or_set(self.doc.text, "meshes", self.doc.meshes.text, &copies);
        Ok(())
    }
}

fn edit_mesh<'a>(
    edits: &mut JsonEdits<'a>,
    mesh: &'a str,
    changes: &[(usize, AttributeSlot, usize)],
    stale: impl Iterator<Item = usize>,
) {
    let primitives = list_of(mesh, "primitives");
    for (primitive, slot, accessor) in changes {
        let primitive = primitives.get(*primitive);
        let attributes = match slot.target {
            None => primitive.and_then(|p| value_of(p, "attributes")),
            Some(target) => {
                let targets = primitive.and_then(|p| items(value_of(p, "targets")?).ok());
                targets.and_then(|all| all.get(target).copied())
            }
        };
        if let Some(attributes) = attributes {
            edits.set(attributes, slot.role.name(), accessor);
        }
    }
    for primitive in stale.filter_map(|p| primitives.get(p)) {
        edits.remove_extension(primitive, DRACO);
    }
}
