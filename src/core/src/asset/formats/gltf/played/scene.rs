//! New nodes in the scenes of a document, and which of its clips still say something true.

use super::super::document::GltfDocument;
use super::super::edited::JsonSections;
use super::super::schema::GltfSkin;
use super::super::text::{items, json_array, json_object, parse_index, value_of, with_member, without_keys};
use super::document::PlayedDocument;
use super::primitives::PlayedNode;
use crate::asset::played_clip::ClipBeside;
use std::collections::BTreeSet;

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
        scenes.push(with_member(doc.scenes.items[i], "nodes", json_array(nodes)));
    }
    if scenes.is_empty() {
        let taken = above.map_or_else(|| top_nodes(doc), |(above, _)| vec![above]);
        scenes.push(json_object([("nodes", json_array(taken.iter().chain(added)))]));
    }
    sections.insert("scenes", Some(json_array(&scenes)));
    sections.insert("scene", Some(target.to_string()));
}

/// Takes the mesh off a node; `name` and whatever else it has stay.
pub(super) fn take_mesh(played: &mut PlayedDocument<'_, '_>, node: usize) {
    let bare = without_keys(played.node(node), &["mesh", "skin", "weights"]);
    played.set_node(node, bare);
}

/// The name of a node as a member of another, with a comma before it; nothing where it has none.
pub(super) fn name_member(doc: &GltfDocument<'_>, node: usize) -> String {
    let name = value_of(doc.nodes.items[node], "name");
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
    let skins = skins
        .iter()
        .filter_map(|skin| serde_json::from_str(doc.skins.get(*skin)?).ok());
    let mut lost = BTreeSet::new();
    for joint in skins.flat_map(|skin: GltfSkin| skin.joints) {
        let mut next = Some(joint.index());
        while let Some(node) = next.filter(|node| lost.insert(*node)) {
            next = parents.get(node).copied().flatten();
        }
    }
    let weighted: BTreeSet<usize> = nodes.iter().map(|n| n.node).collect();
    let moves_lost = |channel: &str| {
        let target = value_of(channel, "target");
        let node = target.and_then(|t| value_of(t, "node")).and_then(parse_index);
        let is_weights = target.and_then(|t| value_of(t, "path")) == Some("\"weights\"");
        node.is_some_and(|node| lost.contains(&node) || (is_weights && weighted.contains(&node)))
    };
    let is_kept = |clip: &&&str| {
        let channels = value_of(clip, "channels").and_then(|list| items(list).ok());
        !channels.unwrap_or_default().into_iter().any(moves_lost)
    };
    let others = doc.animations.iter().enumerate();
    let others = others.filter(|(number, _)| beside.is_none_or(|beside| beside.clip != *number));
    let kept = others.map(|(_, text)| text).filter(is_kept);
    kept.map(|text| (*text).to_owned()).collect()
}

/// The document's skins, where a node that is not played still needs one; `None` where none does.
pub(super) fn kept_skins(doc: &GltfDocument<'_>, nodes: &[PlayedNode<'_>]) -> Option<Vec<String>> {
    let played: BTreeSet<usize> = nodes.iter().map(|n| n.node).collect();
    let mut others = doc.nodes.values.iter().enumerate();
    let is_used = others.any(|(i, node)| node.skin.is_some() && !played.contains(&i));
    is_used.then(|| doc.skins.iter().map(|text| (*text).to_owned()).collect())
}
