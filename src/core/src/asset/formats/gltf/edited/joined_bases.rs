//! What other models bring into the document of the first.

use super::super::document::GltfDocument;
use super::super::text::{list_of, with_member};
use std::collections::BTreeMap;

/// What joins the document. Accessors are numbered virtually, as in the frame.
#[derive(Default)]
pub(super) struct JoinedBases {
    pub(super) meshes: Vec<String>,
    /// Nodes; their meshes count from 0 among the joined ones.
    pub(super) nodes: Vec<(String, Option<usize>)>,
    /// The new nodes that the scene lists.
    pub(super) roots: Vec<usize>,
    pub(super) materials: Vec<String>,
    pub(super) textures: Vec<String>,
    pub(super) samplers: Vec<String>,
    /// Images; with their new view, if they have one.
    pub(super) images: Vec<(String, Option<usize>)>,
    pub(super) extensions_used: Vec<String>,
    pub(super) extensions_required: Vec<String>,
    pub(super) companions: BTreeMap<String, Vec<u8>>,
}

impl JoinedBases {
    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The new nodes, with joined meshes numbered from `first_mesh` on.
    pub(super) fn node_texts(&self, first_mesh: usize) -> Vec<String> {
        let one = |(text, mesh): &(String, Option<usize>)| match mesh {
            Some(mesh) => with_member(text, "mesh", first_mesh + mesh),
            None => text.clone(),
        };
        self.nodes.iter().map(one).collect()
    }

    /// The new images, with new views numbered from `first_view` on.
    pub(super) fn image_texts(&self, first_view: usize) -> Vec<String> {
        let one = |(text, view): &(String, Option<usize>)| match view {
            Some(view) => with_member(text, "bufferView", first_view + view),
            None => text.clone(),
        };
        self.images.iter().map(one).collect()
    }
}

/// The stored items of a section and those that have joined it.
pub(super) fn next_number(frame: &GltfDocument<'_>, key: &str, joined: usize) -> usize {
    list_of(frame.text, key).len() + joined
}
