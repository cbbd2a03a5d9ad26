//! Frames as joints that carry every vertex.

use super::super::edited::{JsonSections, NewAccessorKind, places};
use super::super::float_json::json_floats;
use super::super::read::GltfNotes;
use super::super::text::quoted;
use super::channels::{NewClip, add_times};
use super::document::PlayedDocument;
use super::primitives::{PlayedNode, PrimitiveChanges, RestPrimitive, changed_mesh, played_nodes};
use super::scene::{kept_clips, kept_skins, name_member, scene_sections, take_mesh};
use crate::asset::played_clip::{NodePlace, SkinnedClip};
use crate::asset::{Error, Geometry, Model};
use glam::{DAffine3, DQuat};

/// Adds a clip of joints; the sections of the document that it changes.
pub(super) fn add_clip(
    played: &mut PlayedDocument<'_, '_>,
    rest: &Model,
    notes: &GltfNotes,
    vertices: &[u32],
    clip: &SkinnedClip<'_>,
) -> Result<JsonSections, Error> {
    let doc = played.doc;
    let nodes = played_nodes(notes);
    let mut skins = kept_skins(doc, &nodes).unwrap_or_default();
    let skin = skins.len();
    let mut drawn = Vec::new();
    for node in &nodes {
        let changes = node_changes(played, node, rest, vertices, clip);
        let mesh = played.set_mesh(node.mesh, changed_mesh(doc.meshes.items[node.mesh], &changes));
        take_mesh(played, node.node);
        let name = name_member(doc, node.node);
        drawn.push(played.add_node(format!(r#"{{"mesh":{mesh},"skin":{skin}{name}}}"#)));
    }

    let stands: Vec<NodePlace> = clip.joints.iter().map(|joint| as_stored(&joint.rest)).collect();
    let mut joints = Vec::new();
    for (joint, stand) in clip.joints.iter().zip(&stands) {
        let shift = json_floats(&stand.translation.as_vec3().to_array());
        let turn = json_floats(&stand.rotation.to_array().map(|v| v as f32));
        let name = quoted(&joint.name);
        joints.push(played.add_node(format!(r#"{{"name":{name},"translation":{shift},"rotation":{turn}}}"#)));
    }
    let numbers: Vec<String> = joints.iter().map(ToString::to_string).collect();
    let numbers = places::json_array(&numbers);
    let root = played.add_node(format!(r#"{{"name":"root motion","children":{numbers}}}"#));
    let back: Vec<f32> = stands.iter().flat_map(inverse_matrix).collect();
    let back = played.add_floats(&back, "MAT4", NewAccessorKind::Numbers);
    skins.push(format!(
        r#"{{"inverseBindMatrices":{back},"joints":{numbers},"skeleton":{root}}}"#
    ));

    let mut new = NewClip::new(clip.name);
    let times = add_times(played, clip.times);
    for (number, joint) in joints.iter().enumerate() {
        new.add_places(played, *joint, times, clip.frames.iter().map(|frame| frame[number]));
    }
    if let Some(keys) = &clip.root {
        new.add_keys(played, root, keys);
    }
    let mut sections = JsonSections::new();
    let mut added = drawn;
    added.push(root);
    scene_sections(doc, &added, None, &mut sections);
    let mut clips = kept_clips(doc, &nodes);
    clips.push(new.text());
    sections.insert("animations", Some(places::json_array(&clips)));
    sections.insert("skins", Some(places::json_array(&skins)));
    Ok(sections)
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
    for (_, row) in &node.rows {
        let stand = RestPrimitive::in_model_space(played, row, rest);
        let mut changes = stand.store(played, row, rest);
        let (mut joints, mut weights) = (Vec::new(), Vec::new());
        for vertex in &vertices[row.vertices.clone()] {
            let (own, shares) = stored_influences(&clip.influences[*vertex as usize]);
            joints.extend(own);
            weights.extend(shares);
        }
        let joints = played.doc.accessors.len() + played.fresh.add_joints(&joints);
        changes.attributes.insert("JOINTS_0", joints);
        let weights = played.add_floats(&weights, "VEC4", NewAccessorKind::Floats);
        changes.attributes.insert("WEIGHTS_0", weights);
        all[row.primitive] = changes;
    }
    all
}

/// Joints and weights as a file holds them: each joint once, the heaviest first, weights that sum to 1 as 32-bit floats.
fn stored_influences(influences: &[(u32, f32); 4]) -> ([f32; 4], [f32; 4]) {
    let mut merged: Vec<(u32, f64)> = Vec::with_capacity(4);
    for &(joint, weight) in influences.iter().filter(|(_, w)| *w > 0.0) {
        match merged.iter_mut().find(|(known, _)| *known == joint) {
            Some((_, sum)) => *sum += f64::from(weight),
            None => merged.push((joint, f64::from(weight))),
        }
    }
    merged.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let total: f64 = merged.iter().map(|m| m.1).sum();
    let (mut joints, mut weights) = ([0.0; 4], [0.0; 4]);
    for (i, (joint, weight)) in merged.into_iter().enumerate() {
        weights[i] = (weight / total) as f32;
        // A weight that rounds to none must name the first joint.
        joints[i] = if weights[i] > 0.0 { joint as f32 } else { 0.0 };
    }
    weights[0] = 1.0 - (weights[3] + weights[2] + weights[1]);
    (joints, weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_name_every_joint_once() {
        let (joints, weights) = stored_influences(&[(3, 0.1), (7, 0.3), (3, 0.1), (1, 0.0)]);
        assert_eq!((joints[0], joints[1]), (7.0, 3.0));
        assert!((weights[0] - 0.6).abs() < 1e-6 && (weights[1] - 0.4).abs() < 1e-6);
        assert_eq!(weights.iter().sum::<f32>(), 1.0);
        assert_eq!(stored_influences(&[(5, 0.0); 4]), ([0.0; 4], [1.0, 0.0, 0.0, 0.0]));
    }
}
