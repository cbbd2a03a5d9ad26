//! A document on its way to a new one: nodes and meshes that change, data that is added, the new clip, and which of the old ones stay.

use super::super::builder::{AccessorKind, BufferBuilder, embedded_buffer_text};
use super::super::container::GltfFault;
use super::super::document::{GLB_FORMAT, GltfDocument};
use super::super::read::{GltfNotes, PlacedPrimitive};
use super::super::stored::BufferOrigin;
use super::super::text::{
    JsonSections, WEIGHTS, channel_target, json_array, json_object, list_of, quoted, value_of, with_member,
    without_keys,
};
use crate::moving_scene::{ClipBeside, NodeKeys, NodePlace};
use crate::{Error, FileSet, WrittenFiles};
use glam::DQuat;
use std::collections::{BTreeMap, BTreeSet};

/// A document and what becomes of it.
pub(super) struct PlayedDocument<'d, 'a> {
    pub(super) doc: &'d GltfDocument<'a>,
    pub(super) fresh: BufferBuilder,
    nodes: Vec<String>,
    meshes: Vec<String>,
}

impl<'d, 'a> PlayedDocument<'d, 'a> {
    /// Nothing is changed yet.
    pub(super) fn new(doc: &'d GltfDocument<'a>) -> Self {
        Self {
            doc,
            fresh: BufferBuilder::behind(doc),
            nodes: doc.items(&doc.nodes).map(str::to_owned).collect(),
            meshes: doc.items(&doc.meshes).map(str::to_owned).collect(),
        }
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
        let doc = self.doc;
        let is_bin = doc.origins().next() == Some(&BufferOrigin::Bin);
        let own = doc.buffer_bytes(0).filter(|_| is_bin);
        // The chunk's padding belongs to no view, and what is added begins behind it.
        let mut bytes = own.map(|b| b.to_vec()).unwrap_or_default();
        let mut buffers: Vec<String> = doc.items(&doc.buffers).map(str::to_owned).collect();
        let target = if own.is_some() { 0 } else { buffers.len() };
        let new_views = self.fresh.append_bytes(&mut bytes, target, "a buffer", fault)?;
        let new_accessors = self.fresh.accessor_texts(doc.views.len());
        if own.is_some() {
            buffers[0] = with_member(&buffers[0], "byteLength", bytes.len());
        } else if buffers.is_empty() {
            buffers.push(format!(r#"{{"byteLength":{}}}"#, bytes.len()));
        } else {
            buffers.push(embedded_buffer_text(&bytes));
        }
        let views = doc.items(&doc.views).map(str::to_owned).chain(new_views);
        let accessors = doc.items(&doc.accessors).map(str::to_owned).chain(new_accessors);
        for (key, list) in [
            ("buffers", buffers),
            ("bufferViews", views.collect()),
            ("accessors", accessors.collect()),
            ("nodes", self.nodes),
            ("meshes", self.meshes),
        ] {
            sections.set_list(key, &list);
        }
        let json = sections.replace_in(doc.text.trim_end());
        let chunk = if target == 0 { Some(&bytes[..]) } else { doc.chunk() };
        let main = doc.join(&json, chunk, fault)?;
        let companions = files.owned_companions();
        Ok(WrittenFiles::of(main, companions))
    }
}

/// A clip that is being written.
pub(super) struct NewClip {
    name: String,
    pub(super) channels: Vec<String>,
    samplers: Vec<String>,
}

impl NewClip {
    /// A clip without channels.
    pub(super) fn new(name: &str) -> Self {
        Self {
            name: quoted(name),
            channels: Vec::new(),
            samplers: Vec::new(),
        }
    }

    /// Adds values over times, which are accessors; the number of the sampler.
    pub(super) fn add_sampler(&mut self, times: usize, interpolation: &str, values: usize) -> usize {
        self.add_sampler_text(sampler_text(times, interpolation, values))
    }

    /// Adds a sampler; its number.
    pub(super) fn add_sampler_text(&mut self, text: String) -> usize {
        self.samplers.push(text);
        self.samplers.len() - 1
    }

    /// Lets a sampler move a node.
    pub(super) fn add_channel(&mut self, sampler: usize, node: usize, path: &str) {
        let target = json_object([("node", node.to_string()), ("path", quoted(path))]);
        let channel = [("sampler", sampler.to_string()), ("target", target)];
        self.channels.push(json_object(channel));
    }

    /// Lets a node go from place to place.
    pub(super) fn add_places(
        &mut self,
        played: &mut PlayedDocument<'_, '_>,
        node: usize,
        times: usize,
        places: impl Iterator<Item = NodePlace>,
    ) {
        let (mut shifts, mut turns): (Vec<f32>, Vec<f32>) = (Vec::new(), Vec::new());
        let mut before = DQuat::IDENTITY;
        for place in places {
            shifts.extend(place.translation.as_vec3().to_array());
            // Both signs are one turn, but blending takes the short way between equal signs only.
            let turn = if before.dot(place.rotation) < 0.0 {
                -place.rotation
            } else {
                place.rotation
            };
            before = turn;
            turns.extend(turn.to_array().map(|v| v as f32));
        }
        for (values, shape, path) in [(shifts, "VEC3", "translation"), (turns, "VEC4", "rotation")] {
            let values = played.fresh.add_floats(&values, shape, AccessorKind::Numbers);
            let sampler = self.add_sampler(times, "LINEAR", values);
            self.add_channel(sampler, node, path);
        }
    }

    /// Lets a node follow keys.
    pub(super) fn add_keys(&mut self, played: &mut PlayedDocument<'_, '_>, node: usize, keys: &NodeKeys<'_>) {
        let times = add_times(played, keys.times);
        self.add_places(played, node, times, keys.places.iter().copied());
    }

    /// Its text.
    pub(super) fn text(&self) -> String {
        let lists = [("channels", &self.channels), ("samplers", &self.samplers)];
        let lists = lists.map(|(key, list)| (key, json_array(list)));
        json_object([("name", self.name.clone())].into_iter().chain(lists))
    }
}

/// The text of a sampler.
pub(super) fn sampler_text(input: usize, interpolation: &str, output: usize) -> String {
    json_object([
        ("input", input.to_string()),
        ("interpolation", quoted(interpolation)),
        ("output", output.to_string()),
    ])
}

/// Stores times; the number of their accessor.
pub(super) fn add_times(played: &mut PlayedDocument<'_, '_>, times: &[f64]) -> usize {
    let times: Vec<f32> = times.iter().map(|t| *t as f32).collect();
    played.fresh.add_floats(&times, "SCALAR", AccessorKind::Times)
}

/// Adds a node above others that follows keys; its number.
pub(super) fn add_root(
    played: &mut PlayedDocument<'_, '_>,
    clip: &mut NewClip,
    keys: &NodeKeys<'_>,
    below: &[usize],
) -> usize {
    let below = json_array(below);
    let root = played.add_node(format!(r#"{{"name":"root motion","children":{below}}}"#));
    clip.add_keys(played, root, keys);
    root
}

/// What one node draws.
pub(super) struct PlayedNode<'n> {
    pub(super) node: usize,
    pub(super) mesh: usize,
    /// Rows of the table of primitives with their numbers.
    pub(super) rows: Vec<(usize, &'n PlacedPrimitive)>,
    /// The skin that placed it.
    pub(super) skin: Option<usize>,
}

/// The nodes of a table of primitives, in order; those with a skin alone where others go on beside them.
pub(super) fn played_nodes<'n>(notes: &'n GltfNotes, beside: Option<&ClipBeside<'_>>) -> Vec<PlayedNode<'n>> {
    let mut by_node: BTreeMap<usize, PlayedNode<'_>> = BTreeMap::new();
    let is_played = |row: &PlacedPrimitive| beside.is_none() || row.skin.is_some();
    for (number, row) in notes.rows.iter().enumerate().filter(|(_, row)| is_played(row)) {
        let known = by_node.entry(row.node).or_insert_with(|| PlayedNode {
            node: row.node,
            mesh: row.mesh,
            rows: Vec::new(),
            skin: row.skin,
        });
        known.rows.push((number, row));
    }
    by_node.into_values().collect()
}

/// For each node the one that it is a child of.
pub(super) fn parents(doc: &GltfDocument<'_>) -> Vec<Option<usize>> {
    let mut parents = vec![None; doc.nodes.len()];
    for (i, node) in doc.nodes.values.iter().enumerate() {
        node.children.iter().for_each(|child| parents[child.index()] = Some(i));
    }
    parents
}

/// What a node hangs on in the end; the node itself where it hangs on nothing. Readers have refused circles.
fn top_of(parents: &[Option<usize>], mut node: usize) -> usize {
    while let Some(parent) = parents.get(node).copied().flatten() {
        node = parent;
    }
    node
}

/// The nodes at the top of the scene that is drawn, once each. Where a scene lists a node that hangs on another, what that hangs on in the
/// end.
pub(super) fn top_nodes(doc: &GltfDocument<'_>) -> Vec<usize> {
    let parents = parents(doc);
    let scenes = &doc.scenes.values;
    let listed: Vec<usize> = match doc.scene {
        Some(scene) => scenes[scene].nodes.iter().map(|n| n.index()).collect(),
        None if scenes.is_empty() => (0..doc.nodes.len()).collect(),
        None => scenes.iter().flat_map(|s| &s.nodes).map(|n| n.index()).collect(),
    };
    let mut seen = BTreeSet::new();
    let tops = listed.into_iter().map(|node| top_of(&parents, node));
    tops.filter(|node| seen.insert(*node)).collect()
}

/// Puts nodes at the top of the scene that is drawn. `above`: one that has taken all that were there, in every scene.
pub(super) fn scene_sections(
    doc: &GltfDocument<'_>,
    added: &[usize],
    above: Option<(usize, &[usize])>,
    sections: &mut JsonSections,
) {
    let target = doc.scene.unwrap_or(0);
    let mut scenes = Vec::new();
    let mut seen = BTreeSet::new();
    let parents = parents(doc);
    for (i, scene) in doc.scenes.values.iter().enumerate() {
        seen.clear();
        let listed = scene.nodes.iter().map(|n| n.index());
        let moved = listed.map(|node| match above {
            Some((above, taken)) if taken.contains(&top_of(&parents, node)) => above,
            _ => node,
        });
        let more = if i == target { added } else { &[] };
        let nodes = moved.chain(more.iter().copied()).filter(|node| seen.insert(*node));
        scenes.push(with_member(doc.item(&doc.scenes, i), "nodes", json_array(nodes)));
    }
    if scenes.is_empty() {
        let taken = above.map_or_else(|| top_nodes(doc), |(above, _)| vec![above]);
        scenes.push(json_object([("nodes", json_array(taken.iter().chain(added)))]));
    }
    sections.set_list("scenes", &scenes);
    sections.set("scene", target.to_string());
}

/// Takes the mesh off a node; `name` and whatever else it has stay.
pub(super) fn take_mesh(played: &mut PlayedDocument<'_, '_>, node: usize) {
    let bare = without_keys(played.node(node), &["mesh", "skin", "weights"]);
    played.set_node(node, bare);
}

/// The name of a node as a member of another, with a comma before it; nothing where it has none.
pub(super) fn name_member(doc: &GltfDocument<'_>, node: usize) -> String {
    let name = value_of(doc.item(&doc.nodes, node), "name");
    name.map(|name| format!(r#","name":{name}"#)).unwrap_or_default()
}

/// The document's own clips that stay: those that move no joint of a skin that goes, nothing such a joint hangs on, and no
/// weights of what is played. The one that goes on beside what is played is a part of the new one.
pub(super) fn kept_clips(
    doc: &GltfDocument<'_>,
    nodes: &[PlayedNode<'_>],
    beside: Option<&ClipBeside<'_>>,
) -> Vec<String> {
    let parents = parents(doc);
    let skins: BTreeSet<usize> = nodes.iter().filter_map(|n| n.skin).collect();
    let skins = skins.into_iter().filter_map(|skin| doc.read_skin(skin).ok());
    let mut lost = BTreeSet::new();
    for joint in skins.flat_map(|skin| skin.joints) {
        let mut next = Some(joint.index());
        while let Some(node) = next.filter(|node| lost.insert(*node)) {
            next = parents.get(node).copied().flatten();
        }
    }
    let weighted: BTreeSet<usize> = nodes.iter().map(|n| n.node).collect();
    let is_lost = |(node, path): (usize, &str)| lost.contains(&node) || (path == WEIGHTS && weighted.contains(&node));
    let moves_lost = |channel: &str| channel_target(channel).is_some_and(is_lost);
    let is_kept = |clip: &&str| !list_of(clip, "channels").into_iter().any(moves_lost);
    let others = doc.items(&doc.animations).enumerate();
    let others = others.filter(|(number, _)| beside.is_none_or(|beside| beside.clip != *number));
    let kept = others.map(|(_, text)| text).filter(is_kept);
    kept.map(str::to_owned).collect()
}

/// The document's skins, where a node that is not played still needs one.
pub(super) fn kept_skins(doc: &GltfDocument<'_>, nodes: &[PlayedNode<'_>]) -> Vec<String> {
    let played: BTreeSet<usize> = nodes.iter().map(|n| n.node).collect();
    let mut others = doc.nodes.values.iter().enumerate();
    let is_used = others.any(|(i, node)| node.skin.is_some() && !played.contains(&i));
    let skins = doc.items(&doc.skins).filter(|_| is_used);
    skins.map(str::to_owned).collect()
}
