//! Nodes, clips and morph targets of a document as the other modules see them, and which joints hold which vertices.

use super::accessors::{AccessorLayout, ComponentType, ShapeAttribute};
use super::document::GltfDocument;
use super::placement::{VertexInfluences, VertexTransforms, joint_nodes};
use super::read::{GltfNotes, PlacedPrimitive};
use super::scene::{local_transform, place_meshes};
use super::schema::{GltfNode, MeshPrimitive, WholeNumber};
use super::targets::{AttributeSlot, read_displacements};
use super::text::string_of;
use crate::files::within;
use crate::moving_scene::{
    ChannelInterpolation, ChannelValues, JointInfluences, MovingScene, PrimitiveShapes, SceneChannel, SceneClip,
    SceneNode, ScenePrimitive,
};
use crate::{Error, Model, ModelNode};
use glam::{DQuat, DVec3, Vec3};
use pliant_mesh::rotation::fit_rotation;
use serde::Deserialize;

/// How many numbers the channels of one clip may have together: they may share accessors, so that their size is not bounded
/// by the file's.
const MOST_NUMBERS: u64 = 1 << 26;

/// What moves in the scene of a model.
pub(super) fn moving_scene(model: &Model, notes: &GltfNotes) -> Result<MovingScene, Error> {
    let doc = notes.loaded_document(model)?;
    let scene = place_meshes(&doc, &mut Vec::new())?;
    let mut nodes = Vec::with_capacity(doc.nodes.len());
    for (index, node) in doc.nodes.values.iter().enumerate() {
        nodes.push(scene_node(&doc, index, node, scene.parents[index])?);
    }
    let (influences, is_joint) = joint_influences(&doc, notes, model.positions.len())?;
    let animations = doc.items(&doc.animations);
    let names = animations.map(|text| string_of(text, "name").unwrap_or_default());
    let primitives = notes.rows.iter().map(|row| ScenePrimitive {
        node: row.node,
        vertices: row.vertices.clone(),
        has_skin: row.skin.is_some(),
    });
    Ok(MovingScene {
        nodes,
        is_joint,
        primitives: primitives.collect(),
        influences,
        clip_names: names.collect(),
    })
}

fn scene_node(
    doc: &GltfDocument<'_>,
    index: usize,
    node: &GltfNode,
    parent: Option<usize>,
) -> Result<SceneNode, Error> {
    let name = node.name.clone().unwrap_or_default();
    let local = local_transform(doc, index, node)?;
    let (rotation, scale) = match node.matrix {
        Some(_) => {
            let m = &local.matrix3;
            let rotation = fit_rotation(*m);
            let length = |axis: DVec3, unit: DVec3| axis.length().copysign(axis.dot(rotation * unit));
            // A mirrored axis points away from where the rotation takes it.
            let [x, y, z] = DVec3::AXES;
            let scale = DVec3::new(length(m.x_axis, x), length(m.y_axis, y), length(m.z_axis, z));
            (rotation, scale)
        }
        None => (
            node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array).normalize(),
            DVec3::from_array(node.scale.unwrap_or([1.0; 3])),
        ),
    };
    Ok(SceneNode {
        name,
        parent,
        translation: local.translation,
        rotation,
        scale,
        matrix: node.matrix.map(|_| local),
    })
}

/// Which joints hold which render vertices, and which nodes are such joints.
fn joint_influences(
    doc: &GltfDocument<'_>,
    notes: &GltfNotes,
    vertices: usize,
) -> Result<(JointInfluences, Vec<bool>), Error> {
    let mut of_vertex: Vec<Vec<(u32, f32)>> = vec![Vec::new(); vertices];
    let mut is_joint = vec![false; doc.nodes.len()];
    for row in notes.rows.iter().filter(|row| row.follows_joints) {
        let Some(skin) = row.skin.filter(|&skin| skin < doc.skins.len()) else {
            continue;
        };
        let refuse = |problem: String| doc.fault.malformed(format!("nodes/{}", row.node), problem);
        let skin = doc.read_skin(skin).map_err(|e| refuse(e.to_string()))?;
        let joints: Vec<usize> = skin.joints.iter().map(|j| j.index()).collect();
        joints.iter().for_each(|&joint| is_joint[joint] = true);
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let read = VertexInfluences::read(doc, primitive, joints.len()).map_err(refuse)?;
        for (number, vertex) in row.vertices.clone().enumerate() {
            let held = read.of(number).iter();
            of_vertex[vertex] = held
                .map(|&(joint, w)| (joints[joint as usize] as u32, w as f32))
                .collect();
        }
    }
    let mut influences = JointInfluences {
        starts: vec![0],
        entries: Vec::new(),
    };
    for own in of_vertex {
        influences.entries.extend(own);
        influences.starts.push(influences.entries.len() as u32);
    }
    Ok((influences, is_joint))
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct ClipText {
    name: String,
    channels: Vec<ChannelText>,
    samplers: Vec<SamplerText>,
}

#[derive(Deserialize)]
struct ChannelText {
    sampler: WholeNumber,
    target: TargetText,
}

#[derive(Deserialize)]
struct TargetText {
    node: Option<WholeNumber>,
    path: String,
}

#[derive(Deserialize)]
struct SamplerText {
    input: WholeNumber,
    output: WholeNumber,
    #[serde(default)]
    interpolation: Option<String>,
}

/// A clip of a model's scene.
pub(super) fn scene_clip(model: &Model, notes: &GltfNotes, index: usize) -> Result<Option<SceneClip>, Error> {
    let doc = notes.loaded_document(model)?;
    if index >= doc.animations.len() {
        return Ok(None);
    }
    let text = doc.item(&doc.animations, index);
    let place = format!("animations/{index}");
    let clip: ClipText = serde_json::from_str(text).map_err(|e| doc.fault.malformed(&*place, e.to_string()))?;
    let mut reader = ClipReader {
        doc: &doc,
        samplers: &clip.samplers,
        numbers: 0,
    };
    let mut channels = Vec::new();
    for (number, channel) in clip.channels.iter().enumerate() {
        channels.extend(reader.channel(channel, &format!("{place}/channels/{number}"))?);
    }
    Ok(Some(SceneClip {
        name: clip.name,
        channels,
    }))
}

struct ClipReader<'r, 'a> {
    doc: &'r GltfDocument<'a>,
    samplers: &'r [SamplerText],
    numbers: u64,
}

impl ClipReader<'_, '_> {
    /// A channel; `None` for one that moves nothing of a node.
    fn channel(&mut self, channel: &ChannelText, place: &str) -> Result<Option<SceneChannel>, Error> {
        let fault = self.doc.fault;
        let lanes = match channel.target.path.as_str() {
            "rotation" => 4,
            "translation" | "scale" => 3,
            "weights" => 1,
            _ => return Ok(None),
        };
        let Some(node) = channel.target.node.map(WholeNumber::index) else {
            return Ok(None);
        };
        let nodes = self.doc.nodes.len();
        if node >= nodes {
            let problem = format!("is {node}, there are {nodes} nodes");
            return Err(fault.malformed(format!("{place}/target/node"), problem));
        }
        let targets = match channel.target.path.as_str() {
            "weights" => self.targets_of(node),
            _ => 1,
        };
        if targets == 0 {
            return Ok(None);
        }
        let sampler = channel.sampler.index();
        let Some(sampler) = self.samplers.get(sampler) else {
            let problem = format!("is {sampler}, there are {} samplers", self.samplers.len());
            return Err(fault.malformed(format!("{place}/sampler"), problem));
        };
        let interpolation = match sampler.interpolation.as_deref() {
            None | Some("LINEAR") => ChannelInterpolation::Linear,
            Some("STEP") => ChannelInterpolation::Step,
            Some("CUBICSPLINE") => ChannelInterpolation::CubicSpline,
            Some(other) => {
                let problem = format!("is \"{other}\", allowed are LINEAR, STEP and CUBICSPLINE");
                return Err(fault.malformed(format!("{place}/sampler/interpolation"), problem));
            }
        };
        let times = self.values(sampler.input.index(), None, &format!("{place}/sampler/input"))?;
        let values = self.values(sampler.output.index(), Some(lanes), &format!("{place}/sampler/output"))?;
        let each = match interpolation {
            ChannelInterpolation::CubicSpline => 3,
            _ => 1,
        };
        if times.is_empty() || values.len() != times.len() * each * targets * lanes {
            let problem = match targets {
                1 => format!("{} times have {} values", times.len(), values.len() / lanes),
                _ => format!(
                    "{} times have {} values for {targets} morph targets",
                    times.len(),
                    values.len()
                ),
            };
            return Err(fault.malformed(format!("{place}/sampler"), problem));
        }
        if !times.is_sorted() {
            return Err(fault.malformed(format!("{place}/sampler/input"), "the times do not rise"));
        }
        Ok(Some(SceneChannel {
            node,
            times: times.into_iter().map(f64::from).collect(),
            values: channel_values(&channel.target.path, &values, targets),
            interpolation,
        }))
    }

    /// How many morph targets the mesh of a node has.
    fn targets_of(&self, node: usize) -> usize {
        let mesh = self.doc.nodes.values[node].mesh.map(WholeNumber::index);
        let mesh = mesh.and_then(|mesh| self.doc.meshes.values.get(mesh));
        let primitives = mesh.iter().flat_map(|mesh| &mesh.primitives);
        primitives.map(|primitive| primitive.targets.len()).max().unwrap_or(0)
    }

    /// The finite numbers of an accessor with so many lanes, floats or integers that are scaled to them; `None`: times, which are
    /// floats alone.
    fn values(&mut self, accessor: usize, lanes: Option<usize>, place: &str) -> Result<Vec<f32>, Error> {
        let (is_scaled, lanes) = (lanes.is_some(), lanes.unwrap_or(1));
        let fault = self.doc.fault;
        let count = self.doc.accessors.len();
        let Some(described) = self.doc.accessors.get(accessor) else {
            return Err(fault.malformed(place, format!("is {accessor}, there are {count} accessors")));
        };
        let fits = |l: &AccessorLayout| {
            l.lanes == lanes && (l.component == ComponentType::F32 || (described.normalized && is_scaled))
        };
        let Some(layout) = self.doc.layout(accessor).filter(fits) else {
            let problem = format!("accessor {accessor} has elements of another kind than {lanes} floats");
            return Err(fault.malformed(place, problem));
        };
        self.numbers = self
            .numbers
            .saturating_add(described.count.0.saturating_mul(lanes as u64));
        within("numbers of a clip", self.numbers, MOST_NUMBERS)?;
        let values = self.doc.read_values(accessor, layout)?;
        match values.iter().position(|v| !v.is_finite()) {
            Some(at) => Err(fault.malformed(place, format!("number {at} of accessor {accessor} is {}", values[at]))),
            None => Ok(values),
        }
    }
}

/// Numbers as what a channel of this path moves.
fn channel_values(path: &str, values: &[f32], targets: usize) -> ChannelValues {
    let vectors = || {
        let vectors = values.as_chunks::<3>().0.iter();
        vectors.map(|v| DVec3::from_array(v.map(f64::from))).collect()
    };
    match path {
        "rotation" => {
            let rotations = values.as_chunks::<4>().0.iter();
            ChannelValues::Rotation(rotations.map(|q| DQuat::from_array(q.map(f64::from))).collect())
        }
        "translation" => ChannelValues::Translation(vectors()),
        "scale" => ChannelValues::Scale(vectors()),
        _ => {
            let of_target = |target: usize| {
                let own = values.iter().skip(target).step_by(targets);
                own.map(|w| f64::from(*w)).collect()
            };
            ChannelValues::Weights((0..targets).map(of_target).collect())
        }
    }
}

/// How many numbers the morph targets of one model may have together: nodes may share meshes and targets their numbers, so that
/// their size is not bounded by the file's.
pub(super) const MOST_TARGET_NUMBERS: u64 = 1 << 28;

/// The shapes of all primitives, in order.
pub(super) fn primitive_shapes(model: &Model, notes: &GltfNotes) -> Result<Vec<PrimitiveShapes>, Error> {
    let doc = notes.loaded_document(model)?;
    let mut numbers = 0;
    let mut all = Vec::with_capacity(notes.rows.len());
    for row in &notes.rows {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        numbers += 3 * (row.vertices.len() * (1 + primitive.targets.len())) as u64;
        within("numbers of morph targets", numbers, MOST_TARGET_NUMBERS)?;
        let placed = row.placement.transforms(&doc, primitive)?;
        let mut shapes = PrimitiveShapes::default();
        if row.skin.is_none()
            && let Some(stored) = doc.read_attribute(primitive, ShapeAttribute::Position)?
        {
            shapes.positions = vectors(&stored);
        }
        for target in 0..primitive.targets.len() {
            let moves = target_moves(&doc, primitive, target)?;
            shapes.targets.push(in_space_of(row, &placed, moves));
        }
        all.push(shapes);
    }
    Ok(all)
}

fn displacements(target: usize) -> AttributeSlot {
    AttributeSlot {
        target: Some(target),
        role: ShapeAttribute::Position,
    }
}

/// By how much a morph target moves the vertices of a primitive, as stored; none where it moves no positions.
pub(super) fn target_moves(
    doc: &GltfDocument<'_>,
    primitive: &MeshPrimitive,
    target: usize,
) -> Result<Vec<Vec3>, Error> {
    let Some(accessor) = displacements(target).accessor(primitive) else {
        return Ok(Vec::new());
    };
    let moves = read_displacements(doc, accessor)?;
    Ok(moves.map_or_else(Vec::new, |moves| vectors(&moves)))
}

/// Joints take what they place into the model's space.
fn in_space_of(row: &PlacedPrimitive, placed: &VertexTransforms, moves: Vec<Vec3>) -> Vec<Vec3> {
    if row.skin.is_none() {
        return moves;
    }
    let moves = moves.iter().enumerate();
    moves
        .map(|(vertex, shift)| (placed.at(vertex).matrix3 * shift.as_dvec3()).as_vec3())
        .collect()
}

fn vectors(numbers: &[f32]) -> Vec<Vec3> {
    numbers
        .as_chunks::<3>()
        .0
        .iter()
        .map(|v| Vec3::from_array(*v))
        .collect()
}

/// All nodes of the document of a model, by their index.
pub(super) fn model_nodes(model: &Model, notes: &GltfNotes) -> Result<Vec<ModelNode>, Error> {
    let doc = notes.document(model)?;
    let scene = place_meshes(&doc, &mut Vec::new())?;
    let joints = joint_nodes(&doc);
    let nodes = doc.nodes.values.iter().zip(scene.world_from_node).enumerate();
    let of_node = |(index, (node, world_from_node)): (usize, (&super::schema::GltfNode, _))| ModelNode {
        name: node.name.clone().unwrap_or_default(),
        world_from_node,
        is_joint: joints.contains(&index),
    };
    Ok(nodes.map(of_node).collect())
}
