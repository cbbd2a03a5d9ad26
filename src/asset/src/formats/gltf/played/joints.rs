//! Frames as joints that carry every vertex.

use super::super::builder::{AccessorKind, json_floats};
use super::super::read::GltfNotes;
use super::super::text::{JsonSections, json_array, quoted};
use super::beside::go_on_beside;
use super::document::{
    NewClip, PlayedDocument, PlayedNode, add_times, kept_clips, kept_skins, name_member, played_nodes, take_mesh,
};
use super::morphs::{PrimitiveChanges, RestPrimitive, changed_mesh, still_target};
use crate::moving_scene::{CarryingJoints, NodePlace, SkinnedClip};
use crate::{Error, Geometry, Model};
use glam::{DAffine3, DQuat, DVec3, Vec3};

/// Adds a clip of joints; the sections of the document that it changes.
pub(super) fn add_clip(
    played: &mut PlayedDocument<'_, '_>,
    rest: &Model,
    notes: &GltfNotes,
    vertices: &[u32],
    clip: &SkinnedClip<'_>,
) -> Result<JsonSections, Error> {
    let doc = played.doc;
    let nodes = played_nodes(notes, clip.beside.as_ref());
    let mut skins = kept_skins(doc, &nodes);
    let skin = skins.len();
    let mut drawn = Vec::new();
    let correctives = moved_at_rest(rest, vertices, clip);
    for node in &nodes {
        let mut changes = node_changes(played, node, rest, vertices, clip);
        add_correctives(played, node, rest, &correctives, &mut changes);
        let mesh = played.set_mesh(node.mesh, changed_mesh(doc.item(&doc.meshes, node.mesh), &changes));
        take_mesh(played, node.node);
        let name = name_member(doc, node.node);
        drawn.push(played.add_node(format!(r#"{{"mesh":{mesh},"skin":{skin}{name}}}"#)));
    }

    let skeleton = add_skeleton(played, clip);
    let back: Vec<f32> = skeleton.stands.iter().flat_map(inverse_matrix).collect();
    let back = played.fresh.add_floats(&back, "MAT4", AccessorKind::Numbers);
    let (root, numbers) = (skeleton.root, json_array(&skeleton.nodes));
    skins.push(format!(
        r#"{{"inverseBindMatrices":{back},"joints":{numbers},"skeleton":{root}}}"#
    ));

    let mut sections = JsonSections::default();
    let mut added = drawn.clone();
    added.push(root);
    let mut new = NewClip::new(clip.name);
    go_on_beside(played, &mut new, &nodes, clip.beside.as_ref(), &added, &mut sections)?;
    let mut clips = kept_clips(doc, &nodes, clip.beside.as_ref());
    if !clip.frames.is_empty() {
        add_joints(played, &mut new, &skeleton, clip);
        if let Some(correctives) = clip.correctives.filter(|c| !c.shapes.is_empty()) {
            let times = add_times(played, clip.times);
            let weights: Vec<f32> = correctives.weights.iter().flatten().map(|w| *w as f32).collect();
            let weights = played.fresh.add_floats(&weights, "SCALAR", AccessorKind::Numbers);
            let sampler = new.add_sampler(times, "LINEAR", weights);
            drawn.iter().for_each(|node| new.add_channel(sampler, *node, "weights"));
        }
        clips.push(new.text());
    }
    sections.set_list("animations", &clips);
    sections.set_list("skins", &skins);
    Ok(sections)
}

/// The nodes of joints that were added.
struct NewSkeleton {
    /// By joint its node.
    nodes: Vec<usize>,
    /// By joint: its rest place in model space, from its node and those above.
    stands: Vec<NodePlace>,
    /// The root of all.
    root: usize,
}

/// Adds a node for each joint, below that of its parent.
fn add_skeleton(played: &mut PlayedDocument<'_, '_>, clip: &SkinnedClip<'_>) -> NewSkeleton {
    let mut own: Vec<NodePlace> = Vec::with_capacity(clip.joints.len());
    let mut stands: Vec<NodePlace> = Vec::with_capacity(clip.joints.len());
    for joint in clip.joints {
        // What is above counts as it is stored, so that nothing adds up along a chain.
        let above = joint.parent.map(|p| stands[p]);
        let stored = as_stored(&above.map_or(joint.rest, |above| seen_from(&above, &joint.rest)));
        stands.push(above.map_or(stored, |above| placed_by(&above, &stored)));
        own.push(stored);
    }
    let first = played.add_node(String::new());
    let node_of = |joint: usize| first + joint;
    let children = |parent: Option<usize>| {
        let hang = clip.joints.iter().enumerate().filter(|(_, j)| j.parent == parent);
        let nodes: Vec<usize> = hang.map(|(joint, _)| node_of(joint)).collect();
        match nodes.is_empty() {
            true => String::new(),
            false => format!(r#","children":{}"#, json_array(&nodes)),
        }
    };
    for (number, (joint, place)) in clip.joints.iter().zip(&own).enumerate() {
        let shift = json_floats(&place.translation.as_vec3().to_array());
        let turn = json_floats(&place.rotation.to_array().map(|v| v as f32));
        let (name, below) = (quoted(&joint.name), children(Some(number)));
        let text = format!(r#"{{"name":{name},"translation":{shift},"rotation":{turn}{below}}}"#);
        match number {
            0 => played.set_node(first, text),
            _ => _ = played.add_node(text),
        }
    }
    let name = if clip.frames.is_empty() {
        "skeleton"
    } else {
        "root motion"
    };
    let root = played.add_node(format!(r#"{{"name":"{name}"{}}}"#, children(None)));
    NewSkeleton {
        nodes: (0..clip.joints.len()).map(node_of).collect(),
        stands,
        root,
    }
}

/// Lets a clip move the joints.
fn add_joints(played: &mut PlayedDocument<'_, '_>, new: &mut NewClip, skeleton: &NewSkeleton, clip: &SkinnedClip<'_>) {
    let times = add_times(played, clip.times);
    for (number, (joint, node)) in clip.joints.iter().zip(&skeleton.nodes).enumerate() {
        let in_frame = |frame: &Vec<NodePlace>| match joint.parent {
            Some(parent) => seen_from(&frame[parent], &frame[number]),
            None => frame[number],
        };
        new.add_places(played, *node, times, clip.frames.iter().map(in_frame));
    }
    if let Some(keys) = &clip.root {
        new.add_keys(played, skeleton.root, keys);
    }
}

/// A place in model space as one that hangs on another has it.
fn seen_from(above: &NodePlace, place: &NodePlace) -> NodePlace {
    let back = above.rotation.inverse();
    NodePlace {
        translation: back * (place.translation - above.translation),
        rotation: (back * place.rotation).normalize(),
    }
}

/// The other way round.
fn placed_by(above: &NodePlace, own: &NodePlace) -> NodePlace {
    NodePlace {
        translation: above.rotation * own.translation + above.translation,
        rotation: (above.rotation * own.rotation).normalize(),
    }
}

/// A place as 32-bit floats say it, so that its inverse is that of what is stored.
fn as_stored(place: &NodePlace) -> NodePlace {
    NodePlace {
        translation: place.translation.as_vec3().as_dvec3(),
        rotation: DQuat::from_array(place.rotation.to_array().map(|v| f64::from(v as f32))).normalize(),
    }
}

/// The inverse of a place as a matrix in columns.
fn inverse_matrix(place: &NodePlace) -> [f32; 16] {
    let back = DAffine3::from_rotation_translation(place.rotation, place.translation).inverse();
    let [a, b, c] = [back.matrix3.x_axis, back.matrix3.y_axis, back.matrix3.z_axis].map(|v| v.as_vec3());
    let t = back.translation.as_vec3();
    [
        a.x, a.y, a.z, 0.0, b.x, b.y, b.z, 0.0, c.x, c.y, c.z, 0.0, t.x, t.y, t.z, 1.0,
    ]
}

/// What becomes of each primitive of the mesh of a node.
fn node_changes(
    played: &mut PlayedDocument<'_, '_>,
    node: &PlayedNode<'_>,
    rest: &Geometry,
    vertices: &[u32],
    clip: &SkinnedClip<'_>,
) -> Vec<PrimitiveChanges> {
    let count = played.doc.meshes.values[node.mesh].primitives.len();
    let mut all = vec![PrimitiveChanges::default(); count];
    let has_second = clip.influences.iter().any(|own| merged_influences(own).len() > 4);
    for (_, row) in &node.rows {
        let stand = RestPrimitive::in_model_space(played, row, rest);
        let mut changes = stand.store(played, row, rest);
        let own: Vec<StoredInfluences> = vertices[row.vertices.clone()]
            .iter()
            .map(|vertex| stored_influences(&clip.influences[*vertex as usize]))
            .collect();
        for (set, keys) in SETS.iter().enumerate() {
            let range = 4 * set..4 * set + 4;
            // All primitives of a skin have as many sets, since engines read them so.
            if set > 0 && !has_second {
                continue;
            }
            let joints: Vec<f32> = own.iter().flat_map(|i| i.joints[range.clone()].to_vec()).collect();
            let weights: Vec<f32> = own.iter().flat_map(|i| i.weights[range.clone()].to_vec()).collect();
            changes.attributes.insert(keys[0], played.fresh.add_joints(&joints));
            let weights = played.fresh.add_floats(&weights, "VEC4", AccessorKind::Floats);
            changes.attributes.insert(keys[1], weights);
        }
        all[row.primitive] = changes;
    }
    all
}

/// The rest shape with each corrective, normals too.
fn moved_at_rest(rest: &Geometry, vertices: &[u32], clip: &SkinnedClip<'_>) -> Vec<Geometry> {
    let shapes = clip.correctives.iter().flat_map(|c| c.shapes);
    let positions =
        |shape: &Vec<Vec3>| -> Vec<DVec3> { vertices.iter().map(|v| shape[*v as usize].as_dvec3()).collect() };
    shapes.map(|shape| rest.deformed(&positions(shape))).collect()
}

/// Adds a morph target for each corrective to all primitives of a node's mesh.
fn add_correctives(
    played: &mut PlayedDocument<'_, '_>,
    node: &PlayedNode<'_>,
    rest: &Geometry,
    correctives: &[Geometry],
    changes: &mut [PrimitiveChanges],
) {
    if correctives.is_empty() {
        return;
    }
    let doc = played.doc;
    for (i, primitive) in doc.meshes.values[node.mesh].primitives.iter().enumerate() {
        if let Some((_, row)) = node.rows.iter().find(|(_, row)| row.primitive == i) {
            let stand = RestPrimitive::in_model_space(played, row, rest);
            let targets = correctives.iter().map(|moved| stand.target(played, row, moved));
            changes[i].targets = targets.collect();
        } else if let Some(position) = primitive.attribute("POSITION").and_then(|at| doc.accessors.get(at)) {
            let still = still_target(played, position.count.index());
            changes[i].targets = vec![still; correctives.len()];
        }
    }
}

/// Attributes of the first four joints of a vertex, and of four more.
const SETS: [[&str; 2]; 2] = [["JOINTS_0", "WEIGHTS_0"], ["JOINTS_1", "WEIGHTS_1"]];

/// Joints and weights of a vertex as a file holds them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct StoredInfluences {
    joints: [f32; 8],
    weights: [f32; 8],
}

/// Each joint once with all of its weight, the heaviest first.
fn merged_influences(influences: &CarryingJoints) -> Vec<(u32, f64)> {
    let mut merged: Vec<(u32, f64)> = Vec::with_capacity(influences.len());
    for &(joint, weight) in influences.iter().filter(|(_, w)| *w > 0.0) {
        match merged.iter_mut().find(|(known, _)| *known == joint) {
            Some((_, sum)) => *sum += f64::from(weight),
            None => merged.push((joint, f64::from(weight))),
        }
    }
    merged.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    merged
}

/// Each joint once, the heaviest first, weights that sum to 1 as 32-bit floats.
fn stored_influences(influences: &CarryingJoints) -> StoredInfluences {
    let merged = merged_influences(influences);
    let total: f64 = merged.iter().map(|m| m.1).sum();
    let (mut joints, mut weights) = ([0.0; 8], [0.0; 8]);
    for (i, (joint, weight)) in merged.into_iter().enumerate() {
        weights[i] = (weight / total) as f32;
        // A weight that rounds to none must name the first joint.
        joints[i] = if weights[i] > 0.0 { joint as f32 } else { 0.0 };
    }
    let others: f32 = weights[1..].iter().rev().sum();
    weights[0] = 1.0 - others;
    StoredInfluences { joints, weights }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_name_every_joint_once() {
        let mut given = [(0, 0.0); 8];
        given[..4].copy_from_slice(&[(3, 0.1), (7, 0.3), (3, 0.1), (1, 0.0)]);
        let StoredInfluences { joints, weights } = stored_influences(&given);
        assert_eq!((joints[0], joints[1]), (7.0, 3.0));
        assert!((weights[0] - 0.6).abs() < 1e-6 && (weights[1] - 0.4).abs() < 1e-6);
        assert_eq!(weights.iter().sum::<f32>(), 1.0);
        let none = stored_influences(&[(5, 0.0); 8]);
        assert_eq!((none.joints, none.weights[0]), ([0.0; 8], 1.0));
        let eight = stored_influences(&[1, 2, 3, 4, 5, 6, 7, 8].map(|j| (j, 0.1)));
        assert_eq!(eight.joints, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    }
}
