//! Frames as morph targets.

use super::super::builder::AccessorKind;
use super::super::edited::JsonSections;
use super::super::read::GltfNotes;
use super::super::text::{json_array, with_member, without_keys};
use super::beside::go_on_beside;
use super::channels::{NewClip, add_root, add_times};
use super::document::PlayedDocument;
use super::primitives::{PlayedNode, PrimitiveChanges, RestPrimitive, changed_mesh, played_nodes, still_target};
use super::scene::{kept_clips, kept_skins, name_member, scene_sections, take_mesh, top_nodes};
use crate::asset::played_clip::MorphClip;
use crate::asset::{Error, Geometry, Model};
use glam::DVec3;

/// Adds a clip of shapes; the sections of the document that it changes.
pub(super) fn add_clip(
    played: &mut PlayedDocument<'_, '_>,
    rest: &Model,
    notes: &GltfNotes,
    vertices: &[u32],
    clip: &MorphClip<'_>,
) -> Result<JsonSections, Error> {
    let doc = played.doc;
    let nodes = played_nodes(notes, clip.beside.as_ref());
    let mut stands: Vec<Option<RestPrimitive>> = (0..notes.rows.len()).map(|_| None).collect();
    for (number, row) in nodes.iter().flat_map(|node| &node.rows) {
        stands[*number] = Some(if row.skin.is_some() {
            RestPrimitive::in_model_space(played, row, rest)
        } else {
            RestPrimitive::in_place(played, row)?
        });
    }
    let targets = add_targets(played, rest, notes, &stands, &ClipShapes { vertices, clip });

    let mut moved = Vec::new();
    let mut drawing = Vec::new();
    for node in &nodes {
        let changes = node_changes(played, node, rest, (&stands, &targets));
        let mesh = played.set_mesh(node.mesh, changed_mesh(doc.meshes.items[node.mesh], &changes));
        if node.skin.is_some() {
            take_mesh(played, node.node);
            let name = name_member(doc, node.node);
            moved.push(played.add_node(format!(r#"{{"mesh":{mesh}{name}}}"#)));
            drawing.extend(moved.last().copied());
        } else {
            let bare = without_keys(played.node(node.node), &["weights"]);
            played.set_node(node.node, with_member(&bare, "mesh", &mesh.to_string()));
            drawing.push(node.node);
        }
    }

    let mut new = NewClip::new(clip.name);
    let times = add_times(played, clip.times);
    let count = clip.shapes.len();
    let weights: Vec<f32> = (0..count * count)
        .map(|i| f32::from(u8::from(i / count == i % count)))
        .collect();
    let weights = played.add_floats(&weights, "SCALAR", AccessorKind::Numbers);
    let sampler = new.add_sampler(times, weights);
    drawing
        .iter()
        .for_each(|node| new.add_channel(sampler, *node, "weights"));
    let mut sections = JsonSections::new();
    if clip.beside.is_some() {
        let own = match &clip.root {
            Some(keys) => vec![add_root(played, &mut new, keys, &moved)],
            None => moved,
        };
        go_on_beside(played, &mut new, (&nodes, clip.beside.as_ref()), &own, &mut sections)?;
    } else if let Some(keys) = &clip.root {
        let top = top_nodes(doc);
        let below: Vec<usize> = top.iter().chain(&moved).copied().collect();
        let root = add_root(played, &mut new, keys, &below);
        scene_sections(doc, &[root], Some((root, &top)), &mut sections);
    } else if !moved.is_empty() {
        scene_sections(doc, &moved, None, &mut sections);
    }
    let mut clips = kept_clips(doc, &nodes, clip.beside.as_ref());
    clips.push(new.text());
    sections.insert("animations", Some(json_array(&clips)));
    let skins = kept_skins(doc, &nodes);
    sections.insert("skins", skins.map(|list| json_array(&list)));
    Ok(sections)
}

/// Shapes, and for each vertex of the file the one that it is of them.
struct ClipShapes<'c> {
    vertices: &'c [u32],
    clip: &'c MorphClip<'c>,
}

/// For each row the texts of its targets.
fn add_targets(
    played: &mut PlayedDocument<'_, '_>,
    rest: &Geometry,
    notes: &GltfNotes,
    stands: &[Option<RestPrimitive>],
    shapes: &ClipShapes<'_>,
) -> Vec<Vec<String>> {
    let has_normals = stands.iter().flatten().any(RestPrimitive::has_normals);
    let mut moved = rest.clone();
    let mut targets = vec![Vec::new(); notes.rows.len()];
    for shape in shapes.clip.shapes {
        let positions: Vec<DVec3> = shapes.vertices.iter().map(|v| shape[*v as usize].as_dvec3()).collect();
        if has_normals {
            moved = rest.deformed(&positions);
        } else {
            moved.positions = positions;
        }
        for ((row, stand), own) in notes.rows.iter().zip(stands).zip(&mut targets) {
            own.extend(stand.as_ref().map(|stand| stand.target(played, row, &moved)));
        }
    }
    targets
}

/// What becomes of each primitive of the mesh of a node.
fn node_changes(
    played: &mut PlayedDocument<'_, '_>,
    node: &PlayedNode<'_>,
    rest: &Geometry,
    (stands, targets): (&[Option<RestPrimitive>], &[Vec<String>]),
) -> Vec<PrimitiveChanges> {
    let doc = played.doc;
    let count = targets.iter().map(Vec::len).max().unwrap_or(0);
    let mut all = Vec::new();
    for (i, primitive) in doc.meshes.values[node.mesh].primitives.iter().enumerate() {
        let row = node.rows.iter().find(|(_, row)| row.primitive == i);
        let stand = row.and_then(|(number, row)| Some((stands[*number].as_ref()?, row)));
        let mut changes = match stand {
            Some((stand, row)) if node.skin.is_some() => stand.store(played, row, rest),
            _ => PrimitiveChanges {
                drops_joints: node.skin.is_some(),
                ..PrimitiveChanges::default()
            },
        };
        let position = primitive.attribute("POSITION").and_then(|at| doc.accessors.get(at));
        changes.targets = match (row, position) {
            (Some((number, _)), _) => targets[*number].clone(),
            (None, Some(position)) => vec![still_target(played, position.count.index()); count],
            (None, None) => Vec::new(),
        };
        all.push(changes);
    }
    all
}
