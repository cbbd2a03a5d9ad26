//! Frames as morph targets, and the texts of primitives that are played.

use super::super::accessors::ShapeAttribute;
use super::super::builder::AccessorKind;
use super::super::placement::{Placement, invert};
use super::super::read::{GltfNotes, PlacedPrimitive, normal_matrix};
use super::super::schema::DRACO;
use super::super::text::{
    JsonSections, json_array, json_object, list_of, members, value_of, with_member, without_extensions, without_keys,
};
use super::beside::go_on_beside;
use super::document::{
    NewClip, PlayedDocument, PlayedNode, add_root, add_times, kept_clips, kept_skins, name_member, played_nodes,
    scene_sections, take_mesh, top_nodes,
};
use crate::moving_scene::MorphClip;
use crate::{Error, Geometry, Model};
use glam::{DAffine3, DVec3, Vec3};
use std::collections::BTreeMap;

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
        let changes = node_changes(played, node, rest, &stands, &targets);
        let mesh = played.set_mesh(node.mesh, changed_mesh(doc.item(&doc.meshes, node.mesh), &changes));
        if node.skin.is_some() {
            take_mesh(played, node.node);
            let name = name_member(doc, node.node);
            moved.push(played.add_node(format!(r#"{{"mesh":{mesh}{name}}}"#)));
            drawing.extend(moved.last().copied());
        } else {
            let bare = without_keys(played.node(node.node), &["weights"]);
            played.set_node(node.node, with_member(&bare, "mesh", mesh.to_string()));
            drawing.push(node.node);
        }
    }

    let mut new = NewClip::new(clip.name);
    let times = add_times(played, clip.times);
    let count = clip.shapes.len();
    let weights: Vec<f32> = (0..count * count)
        .map(|i| f32::from(u8::from(i / count == i % count)))
        .collect();
    let weights = played.fresh.add_floats(&weights, "SCALAR", AccessorKind::Numbers);
    let sampler = new.add_sampler(times, "LINEAR", weights);
    drawing
        .iter()
        .for_each(|node| new.add_channel(sampler, *node, "weights"));
    let mut sections = JsonSections::default();
    if clip.beside.is_some() {
        let own = match &clip.root {
            Some(keys) => vec![add_root(played, &mut new, keys, &moved)],
            None => moved,
        };
        go_on_beside(played, &mut new, &nodes, clip.beside.as_ref(), &own, &mut sections)?;
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
    sections.set_list("animations", &clips);
    sections.set_list("skins", &kept_skins(doc, &nodes));
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
    stands: &[Option<RestPrimitive>],
    targets: &[Vec<String>],
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

/// A primitive's rest shape, in the space where it is drawn.
pub(super) struct RestPrimitive {
    /// Three numbers a vertex.
    positions: Vec<f32>,
    /// Three numbers a vertex, or none.
    normals: Vec<f32>,
    /// Four numbers a vertex, or none.
    tangents: Vec<f32>,
    /// From model space to that space; `None` where a mesh is flattened.
    own_from_model: Option<DAffine3>,
}

impl RestPrimitive {
    /// A primitive that stays where its node draws it.
    pub(super) fn in_place(played: &PlayedDocument<'_, '_>, row: &PlacedPrimitive) -> Result<Self, Error> {
        let primitive = &played.doc.meshes.values[row.mesh].primitives[row.primitive];
        let read = |role| Ok::<_, Error>(played.doc.read_attribute(primitive, role)?.unwrap_or_default());
        Ok(Self {
            positions: read(ShapeAttribute::Position)?,
            normals: read(ShapeAttribute::Normal)?,
            tangents: read(ShapeAttribute::Tangent)?,
            own_from_model: match &row.placement {
                Placement::Whole(one) => invert(one),
                Placement::Blended(_) => None,
            },
        })
    }

    /// A primitive that is to be drawn in model space.
    pub(super) fn in_model_space(played: &PlayedDocument<'_, '_>, row: &PlacedPrimitive, model: &Geometry) -> Self {
        let primitive = &played.doc.meshes.values[row.mesh].primitives[row.primitive];
        let has = |role: ShapeAttribute| primitive.attribute(role.name()).is_some();
        let own = row.vertices.clone();
        let normals = model.normals.get(own.clone()).filter(|_| has(ShapeAttribute::Normal));
        let tangents = model.tangents.get(own.clone()).filter(|_| has(ShapeAttribute::Tangent));
        let unit = |n: &Vec3| n.try_normalize().unwrap_or(Vec3::Z).to_array();
        let unit_tangent = |t: &glam::Vec4| {
            let [x, y, z] = t.truncate().try_normalize().unwrap_or(Vec3::X).to_array();
            [x, y, z, if t.w < 0.0 { -1.0 } else { 1.0 }]
        };
        Self {
            positions: model.positions[own]
                .iter()
                .flat_map(|p| p.as_vec3().to_array())
                .collect(),
            normals: normals.map_or_else(Vec::new, |all| all.iter().flat_map(unit).collect()),
            tangents: tangents.map_or_else(Vec::new, |all| all.iter().flat_map(unit_tangent).collect()),
            own_from_model: Some(DAffine3::IDENTITY),
        }
    }

    /// Whether light falls on it by normals of its own.
    pub(super) fn has_normals(&self) -> bool {
        !self.normals.is_empty()
    }

    /// Stores what it has in new accessors, and its triangles where they are wound the other way round than its indices.
    pub(super) fn store(
        &self,
        played: &mut PlayedDocument<'_, '_>,
        row: &PlacedPrimitive,
        model: &Geometry,
    ) -> PrimitiveChanges {
        let mut changes = PrimitiveChanges {
            drops_joints: true,
            ..PrimitiveChanges::default()
        };
        let mut add = |key: &'static str, values: &[f32], shape, kind| {
            if !values.is_empty() {
                changes
                    .attributes
                    .insert(key, played.fresh.add_floats(values, shape, kind));
            }
        };
        add("POSITION", &self.positions, "VEC3", AccessorKind::Positions);
        add("NORMAL", &self.normals, "VEC3", AccessorKind::Floats);
        add("TANGENT", &self.tangents, "VEC4", AccessorKind::Floats);
        if row.is_mirrored {
            let first = row.vertices.start as u32;
            let wound = model.triangles[row.triangles.clone()].iter();
            let wound: Vec<[u32; 3]> = wound.map(|t| t.map(|v| v - first)).collect();
            changes.indices = Some(played.fresh.add_indices(&wound, row.vertices.len()));
        }
        changes
    }

    /// The text of a morph target that takes the primitive to `moved`, where the model's vertices are.
    pub(super) fn target(
        &self,
        played: &mut PlayedDocument<'_, '_>,
        row: &PlacedPrimitive,
        moved: &Geometry,
    ) -> String {
        let own = row.vertices.clone();
        let [mut shifts, mut turns, mut twists] = [Vec::new(), Vec::new(), Vec::new()];
        let vector = |v: &[f32]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
        let put = |list: &mut Vec<f32>, new: Option<DVec3>, old: &[f32]| {
            let shift = new.map_or(DVec3::ZERO, |new| new - vector(old));
            list.extend(shift.as_vec3().to_array());
        };
        let from_model = self.own_from_model;
        for (new, old) in moved.positions[own.clone()].iter().zip(self.positions.chunks_exact(3)) {
            put(&mut shifts, from_model.map(|m| m.transform_point3(*new)), old);
        }
        let across = from_model.map(|m| normal_matrix(&m.matrix3));
        for (new, old) in moved.normals.iter().skip(own.start).zip(self.normals.chunks_exact(3)) {
            let new = across.and_then(|m| (m * new.as_dvec3()).try_normalize());
            put(&mut turns, new, old);
        }
        for (new, old) in moved.tangents.iter().skip(own.start).zip(self.tangents.chunks_exact(4)) {
            let new = from_model.and_then(|m| (m.matrix3 * new.truncate().as_dvec3()).try_normalize());
            put(&mut twists, new, old);
        }
        let mut members = Vec::new();
        for (key, values, kind) in [
            ("POSITION", &shifts, AccessorKind::Positions),
            ("NORMAL", &turns, AccessorKind::Floats),
            ("TANGENT", &twists, AccessorKind::Floats),
        ] {
            if !values.is_empty() {
                members.push((key, played.fresh.add_floats(values, "VEC3", kind)));
            }
        }
        json_object(members)
    }
}

/// The text of a target that moves none of so many vertices.
pub(super) fn still_target(played: &mut PlayedDocument<'_, '_>, vertices: usize) -> String {
    let at = played
        .fresh
        .add_floats(&vec![0.0; 3 * vertices], "VEC3", AccessorKind::Positions);
    format!(r#"{{"POSITION":{at}}}"#)
}

/// What becomes of a primitive.
#[derive(Debug, Clone, Default)]
pub(super) struct PrimitiveChanges {
    /// New accessors of attributes.
    pub(super) attributes: BTreeMap<&'static str, usize>,
    /// Whether it loses the joints that it had.
    pub(super) drops_joints: bool,
    /// New triangles, as an accessor of indices.
    pub(super) indices: Option<usize>,
    /// Its morph targets.
    pub(super) targets: Vec<String>,
}

/// A mesh with changes of all of its primitives.
pub(super) fn changed_mesh(mesh: &str, changes: &[PrimitiveChanges]) -> String {
    let primitives = list_of(mesh, "primitives").into_iter().zip(changes);
    let primitives: Vec<String> = primitives
        .map(|(text, changes)| changed_primitive(text, changes))
        .collect();
    let mut mesh = without_keys(mesh, &["weights"]);
    let names = value_of(&mesh, "extras").filter(|extras| value_of(extras, "targetNames").is_some());
    if let Some(left) = names.map(|extras| without_keys(extras, &["targetNames"])) {
        mesh = with_member(&mesh, "extras", &left);
    }
    with_member(&mesh, "primitives", json_array(&primitives))
}

fn changed_primitive(primitive: &str, changes: &PrimitiveChanges) -> String {
    let stored = value_of(primitive, "attributes").and_then(|object| members(object).ok());
    let is_joint = |key: &str| key.starts_with("JOINTS_") || key.starts_with("WEIGHTS_");
    let stored = stored.unwrap_or_default().into_iter().filter(|m| {
        let is_dropped = changes.drops_joints && is_joint(&m.key);
        !is_dropped && !changes.attributes.contains_key(m.key.as_str())
    });
    let mut attributes: Vec<(String, String)> = stored.map(|m| (m.key, m.value.to_owned())).collect();
    let added = changes.attributes.iter();
    attributes.extend(added.map(|(key, at)| ((*key).to_owned(), at.to_string())));
    let mut text = without_keys(primitive, &["targets"]);
    text = without_extensions(&text, &[DRACO]);
    text = with_member(&text, "attributes", json_object(attributes));
    if let Some(indices) = changes.indices {
        text = without_keys(&text, &["mode"]);
        text = with_member(&text, "indices", indices);
    }
    if !changes.targets.is_empty() {
        text = with_member(&text, "targets", json_array(&changes.targets));
    }
    text
}
