//! Blend shapes and their clips on a rest file: skins, nodes and all other clips stay.

use super::super::accessors::ShapeAttribute;
use super::super::builder::{AccessorKind, bounds};
use super::super::placement::VertexTransforms;
use super::super::read::{GltfNotes, PlacedPrimitive, normal_matrix};
use super::super::text::{
    JsonSections, WEIGHTS, channel_target, json_array, json_object, list_of, quoted, value_of, with_member,
    without_keys,
};
use super::document::{NewClip, PlayedDocument, PlayedNode, add_times, played_nodes};
use super::morphs::{PrimitiveChanges, changed_mesh};
use crate::moving_scene::{BlendClip, BlendShapes, ChannelInterpolation};
use crate::{Error, Geometry, Model};
use glam::{DVec3, Vec3};
use std::collections::BTreeSet;

/// Adds shapes to the nodes that they move, and their clips; the sections of the document that it changes.
pub(super) fn add_shapes(
    played: &mut PlayedDocument<'_, '_>,
    rest: &Model,
    notes: &GltfNotes,
    vertices: &[u32],
    shapes: &BlendShapes,
) -> Result<JsonSections, Error> {
    let mut is_moved = vec![false; rest.positions.len()];
    for shape in &shapes.shapes {
        for (moved, v) in is_moved.iter_mut().zip(vertices) {
            *moved |= shape.moves[*v as usize] != Vec3::ZERO;
        }
    }
    let moves_of = |row: &PlacedPrimitive| is_moved[row.vertices.clone()].contains(&true);
    let mut nodes = played_nodes(notes, None);
    nodes.retain(|node| node.rows.iter().any(|(_, row)| moves_of(row)));
    let rows = nodes.iter().flat_map(|node| &node.rows);
    let spaces = rows.map(|(number, row)| Ok((*number, RowSpace::of(played, row)?)));
    let spaces: Vec<(usize, RowSpace)> = spaces.collect::<Result<_, Error>>()?;
    let mut targets = vec![Vec::new(); notes.rows.len()];
    let turns = shapes.has_normals && spaces.iter().any(|(_, space)| space.has_normals);
    for shape in &shapes.shapes {
        let moves: Vec<Vec3> = vertices.iter().map(|v| shape.moves[*v as usize]).collect();
        let moved = turns.then(|| {
            let at = rest.positions.iter().zip(&moves);
            rest.deformed(&at.map(|(p, m)| *p + m.as_dvec3()).collect::<Vec<DVec3>>())
        });
        for (number, space) in &spaces {
            let row = &notes.rows[*number];
            let told = ToldShape {
                moves: &moves[row.vertices.clone()],
                moved: moved.as_ref(),
                has_tangents: shapes.has_tangents,
            };
            targets[*number].push(space.target(played, row, rest, &told));
        }
    }
    for node in &nodes {
        draw_shapes(played, node, &targets, shapes);
    }
    let mut sections = JsonSections::default();
    let drawing: BTreeSet<usize> = nodes.iter().map(|node| node.node).collect();
    let mut clips = clips_without_weights(played, &drawing);
    for clip in shapes.clips.iter().filter(|_| !nodes.is_empty()) {
        let name = unused_name(&clip.name, &clips);
        let clip = BlendClip { name, ..clip.clone() };
        clips.push(new_clip(played, &clip, &drawing, shapes));
    }
    sections.set_list("animations", &clips);
    Ok(sections)
}

/// The space that the vertices of a primitive are stored in.
struct RowSpace {
    /// `None` where a mesh is flattened, so that nothing can move.
    own_from_model: Option<VertexTransforms>,
    has_normals: bool,
    has_tangents: bool,
}

/// What a shape does to a primitive.
struct ToldShape<'s> {
    moves: &'s [Vec3],
    /// The whole model in that shape, where normals turn with it.
    moved: Option<&'s Geometry>,
    has_tangents: bool,
}

impl RowSpace {
    fn of(played: &PlayedDocument<'_, '_>, row: &PlacedPrimitive) -> Result<Self, Error> {
        let primitive = &played.doc.meshes.values[row.mesh].primitives[row.primitive];
        let has = |role: ShapeAttribute| primitive.attribute(role.name()).is_some();
        Ok(Self {
            own_from_model: row.placement.transforms(played.doc, primitive)?.inverse(),
            has_normals: has(ShapeAttribute::Normal),
            has_tangents: has(ShapeAttribute::Tangent),
        })
    }

    /// The text of the morph target that a shape is.
    fn target(
        &self,
        played: &mut PlayedDocument<'_, '_>,
        row: &PlacedPrimitive,
        rest: &Geometry,
        told: &ToldShape<'_>,
    ) -> String {
        let first = row.vertices.start;
        let count = row.vertices.len();
        let back = self.own_from_model.as_ref();
        let shift = |k: usize| {
            let still = told.moves[k] == Vec3::ZERO;
            let back = back.filter(|_| !still)?;
            Some((back.at(k).matrix3 * told.moves[k].as_dvec3()).as_vec3())
        };
        let mut members = vec![("POSITION", add_moves(played, count, true, shift))];
        let Some(moved) = told.moved.filter(|_| self.has_normals) else {
            return json_object(members);
        };
        let turn = |k: usize| {
            let (before, after) = (*rest.normals.get(first + k)?, *moved.normals.get(first + k)?);
            let across = normal_matrix(&back.filter(|_| before != after)?.at(k).matrix3);
            let unit = |n: Vec3| (across * n.as_dvec3()).normalize_or_zero();
            Some((unit(after) - unit(before)).as_vec3())
        };
        members.push(("NORMAL", add_moves(played, count, false, turn)));
        if self.has_tangents && told.has_tangents {
            let twist = |k: usize| {
                let (before, after) = (*rest.tangents.get(first + k)?, *moved.tangents.get(first + k)?);
                let along = back.filter(|_| before != after)?.at(k).matrix3;
                let unit = |t: Vec3| (along * t.as_dvec3()).normalize_or_zero();
                Some((unit(after.truncate()) - unit(before.truncate())).as_vec3())
            };
            members.push(("TANGENT", add_moves(played, count, false, twist)));
        }
        json_object(members)
    }
}

/// Stores displacements, those of most vertices being none as an accessor that lists the others alone; its number.
fn add_moves(
    played: &mut PlayedDocument<'_, '_>,
    count: usize,
    is_position: bool,
    of: impl Fn(usize) -> Option<Vec3>,
) -> usize {
    let all: Vec<[f32; 3]> = (0..count).map(|k| of(k).unwrap_or(Vec3::ZERO).to_array()).collect();
    let moving = (0u32..).zip(&all).filter(|(_, value)| **value != [0.0; 3]);
    let (places, values): (Vec<u32>, Vec<[f32; 3]>) = moving.unzip();
    let bounds = is_position.then(|| bounds(all.as_flattened(), 3));
    if places.len() >= count / 4 * 3 {
        return played.fresh.push_floats(all.as_flattened(), "VEC3", None, bounds);
    }
    played.fresh.push_displacements(count, &places, &values, bounds)
}

/// Lets a node draw its mesh with targets.
fn draw_shapes(
    played: &mut PlayedDocument<'_, '_>,
    node: &PlayedNode<'_>,
    targets: &[Vec<String>],
    shapes: &BlendShapes,
) {
    let doc = played.doc;
    let mut changes = Vec::new();
    for (i, primitive) in doc.meshes.values[node.mesh].primitives.iter().enumerate() {
        let row = node.rows.iter().find(|(_, row)| row.primitive == i);
        let position = primitive.attribute("POSITION").and_then(|at| doc.accessors.get(at));
        let targets = match (row, position) {
            (Some((number, _)), _) => targets[*number].clone(),
            (None, Some(position)) => {
                let still = add_moves(played, position.count.index(), true, |_| None);
                vec![format!(r#"{{"POSITION":{still}}}"#); shapes.shapes.len()]
            }
            (None, None) => Vec::new(),
        };
        changes.push(PrimitiveChanges {
            targets,
            ..PrimitiveChanges::default()
        });
    }
    let mut mesh = changed_mesh(doc.item(&doc.meshes, node.mesh), &changes);
    if shapes.shapes.iter().any(|shape| shape.weight != 0.0) {
        mesh = with_member(
            &mesh,
            "weights",
            json_array(shapes.shapes.iter().map(|shape| shape.weight)),
        );
    }
    let names = json_array(shapes.shapes.iter().map(|shape| quoted(&shape.name)));
    let extras = value_of(&mesh, "extras")
        .filter(|extras| extras.starts_with('{'))
        .unwrap_or("{}")
        .to_owned();
    mesh = with_member(&mesh, "extras", with_member(&extras, "targetNames", names));
    let mesh = played.set_mesh(node.mesh, mesh);
    let bare = without_keys(played.node(node.node), &["weights"]);
    played.set_node(node.node, with_member(&bare, "mesh", mesh));
}

/// The document's clips without the weights of some nodes; clips of nothing else go.
fn clips_without_weights(played: &PlayedDocument<'_, '_>, nodes: &BTreeSet<usize>) -> Vec<String> {
    let doc = played.doc;
    let weighs =
        |channel: &&str| channel_target(channel).is_some_and(|(node, path)| path == WEIGHTS && nodes.contains(&node));
    let mut kept = Vec::new();
    for text in doc.items(&doc.animations) {
        let channels = list_of(text, "channels");
        let others: Vec<&str> = channels.iter().copied().filter(|channel| !weighs(channel)).collect();
        match others.len() {
            count if count == channels.len() => kept.push(text.to_owned()),
            0 => {}
            _ => kept.push(with_member(text, "channels", json_array(others))),
        }
    }
    kept
}

/// The name of a clip, with a number behind it where another of these has it: players choose clips by their names.
fn unused_name(name: &str, clips: &[String]) -> String {
    let taken = |name: &str| {
        let quoted = quoted(name);
        clips.iter().any(|clip| value_of(clip, "name") == Some(quoted.as_str()))
    };
    let numbered = (2..).map(|k| format!("{name} {k}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    names
        .find(|name| name.is_empty() || !taken(name))
        .unwrap_or_else(|| name.to_owned())
}

/// A clip of weights on all nodes that have the shapes.
fn new_clip(
    played: &mut PlayedDocument<'_, '_>,
    clip: &BlendClip,
    nodes: &BTreeSet<usize>,
    shapes: &BlendShapes,
) -> String {
    let each = match clip.interpolation {
        ChannelInterpolation::CubicSpline => 3,
        _ => 1,
    };
    let mut values = vec![0.0; shapes.shapes.len() * each * clip.times.len()];
    for (shape, weights) in &clip.weights {
        for (place, weight) in values.iter_mut().skip(*shape).step_by(shapes.shapes.len()).zip(weights) {
            *place = *weight as f32;
        }
    }
    let mut new = NewClip::new(&clip.name);
    let times = add_times(played, &clip.times);
    let values = played.fresh.add_floats(&values, "SCALAR", AccessorKind::Numbers);
    let sampler = new.add_sampler(times, interpolation_name(clip.interpolation), values);
    nodes.iter().for_each(|node| new.add_channel(sampler, *node, "weights"));
    new.text()
}

fn interpolation_name(interpolation: ChannelInterpolation) -> &'static str {
    match interpolation {
        ChannelInterpolation::Step => "STEP",
        ChannelInterpolation::Linear => "LINEAR",
        ChannelInterpolation::CubicSpline => "CUBICSPLINE",
    }
}
