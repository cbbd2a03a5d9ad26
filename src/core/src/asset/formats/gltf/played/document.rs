//! A document on its way to a new one: nodes and meshes that change, and data that is added.

use super::super::accessors::{AccessorLayout, ShapeAttribute, check_unbacked, read_floats, read_values};
use super::super::buffers::{BufferBytes, BufferOrigin};
use super::super::builder::{AccessorKind, BufferBuilder, embedded_buffer_text};
use super::super::container;
use super::super::document::{GLB_FORMAT, GltfDocument};
use super::super::edited::{JsonSections, replace_members};
use super::super::fault::GltfFault;
use super::super::text::{items, json_array, value_of, with_member};
use crate::asset::{Error, FileSet, WrittenFiles};
use std::collections::BTreeSet;

/// A document and what becomes of it.
pub(super) struct PlayedDocument<'d, 'a> {
    pub(super) doc: &'d GltfDocument<'a>,
    pub(super) fresh: BufferBuilder,
    buffers: BufferBytes<'static>,
    nodes: Vec<String>,
    meshes: Vec<String>,
}

impl<'d, 'a> PlayedDocument<'d, 'a> {
    /// Nothing is changed yet.
    pub(super) fn new(doc: &'d GltfDocument<'a>, buffers: BufferBytes<'static>) -> Self {
        let owned = |list: &[&str]| list.iter().map(|text| (*text).to_owned()).collect();
        Self {
            doc,
            fresh: BufferBuilder::default(),
            buffers,
            nodes: owned(&doc.nodes.items),
            meshes: owned(&doc.meshes.items),
        }
    }

    /// Adds floats; the number of their accessor.
    pub(super) fn add_floats(&mut self, values: &[f32], shape: &'static str, kind: AccessorKind) -> usize {
        let lanes = match shape {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        self.doc.accessors.len() + self.fresh.add_floats(values, lanes, shape, kind)
    }

    /// The values of an attribute of vertices.
    pub(super) fn read_attribute(&mut self, accessor: usize, role: ShapeAttribute) -> Result<Vec<f32>, Error> {
        self.buffers.decode_for(self.doc, &BTreeSet::from([accessor]))?;
        read_floats(self.doc, &self.buffers, accessor, role)
    }

    /// The numbers of an accessor, and how many each of its elements has; `None` for one that is not there or of no kind known.
    pub(super) fn read_numbers(&mut self, accessor: usize) -> Result<Option<(Vec<f32>, usize)>, Error> {
        let described = self.doc.accessors.get(accessor);
        let Some(layout) = described.and_then(|a| AccessorLayout::of(a, self.doc.views.values)) else {
            return Ok(None);
        };
        check_unbacked(self.doc, accessor, layout)?;
        self.buffers.decode_for(self.doc, &BTreeSet::from([accessor]))?;
        Ok(Some((
            read_values(self.doc, &self.buffers, accessor, layout)?,
            layout.lanes,
        )))
    }

    /// A node as it is by now.
    pub(super) fn node(&self, node: usize) -> &str {
        self.nodes.get(node).map_or("{}", String::as_str)
    }

    /// Puts a text in place of a node's.
    pub(super) fn set_node(&mut self, node: usize, text: String) {
        if let Some(place) = self.nodes.get_mut(node) {
            *place = text;
        }
    }

    /// Adds a node; its number.
    pub(super) fn add_node(&mut self, text: String) -> usize {
        self.nodes.push(text);
        self.nodes.len() - 1
    }

    /// Stores a changed mesh for one node: in its place where no other node draws it, else behind all others. Its number.
    pub(super) fn set_mesh(&mut self, mesh: usize, text: String) -> usize {
        let drawn = self.doc.nodes.values.iter().filter_map(|n| n.mesh);
        if drawn.filter(|m| m.index() == mesh).count() > 1 {
            self.meshes.push(text);
            return self.meshes.len() - 1;
        }
        self.meshes[mesh] = text;
        mesh
    }

    /// Puts the files together. `sections`: the members of the document that are neither nodes, meshes nor data.
    pub(super) fn finish(self, files: &FileSet, mut sections: JsonSections) -> Result<WrittenFiles, Error> {
        let fault = GltfFault(GLB_FORMAT);
        let stored = self.buffers.stored.first().filter(|s| s.origin == BufferOrigin::Bin);
        let own = stored.and_then(|s| s.bytes.as_ref());
        // The chunk's padding belongs to no view, and what is added begins behind it.
        let mut bytes = own.map(|b| b.to_vec()).unwrap_or_default();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        self.fresh.check_size(bytes.len(), "a buffer", fault)?;
        let (views, accessors) = (self.doc.views.len(), self.doc.accessors.len());
        let mut buffers: Vec<String> = self.doc.buffers.items.iter().map(|text| (*text).to_owned()).collect();
        let target = if own.is_some() { 0 } else { buffers.len() };
        let new_views = self.fresh.view_texts(target, bytes.len());
        let new_accessors = self.fresh.accessor_texts(views);
        bytes.extend_from_slice(self.fresh.bytes());
        if own.is_some() {
            buffers[0] = with_member(&buffers[0], "byteLength", bytes.len());
        } else if buffers.is_empty() {
            buffers.push(format!(r#"{{"byteLength":{}}}"#, bytes.len()));
        } else {
            buffers.push(embedded_buffer_text(&bytes));
        }
        let lists: [(&'static str, Vec<String>, usize); 5] = [
            ("buffers", buffers, 0),
            ("bufferViews", new_views, views),
            ("accessors", new_accessors, accessors),
            ("nodes", self.nodes, 0),
            ("meshes", self.meshes, 0),
        ];
        for (key, mut list, stored) in lists {
            if stored > 0 {
                let old = value_of(self.doc.text, key).and_then(|array| items(array).ok());
                let old = old.unwrap_or_default().into_iter().map(str::to_owned);
                list.splice(0..0, old);
            }
            sections.insert(key, (!list.is_empty()).then(|| json_array(&list)));
        }
        let json = replace_members(self.doc.text.trim_end(), sections);
        let rest = self.doc.container.as_ref().map_or(&[][..], |c| &c.rest);
        let is_chunk = target == 0;
        let unused = self.doc.container.as_ref().and_then(|c| c.bin);
        let chunk = if is_chunk { Some(&bytes[..]) } else { unused };
        let main = container::join(&json, chunk, rest, fault)?;
        let companions = files.owned_companions();
        Ok(WrittenFiles::of(main, companions))
    }
}
