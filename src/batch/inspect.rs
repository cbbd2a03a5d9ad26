//! Reports what a model is, what its file holds beside its mesh, and what the solver would use of it, without solving.

use crate::asset::{FileSet, Format, Model, ModelNode};
use crate::engine::{Deformer, DeformerLimits};
use crate::exec::Exec;
use crate::mesh::MeshReport;
use crate::wire::{Error, open_options, pb, session_message};
use serde::{Deserialize, Serialize};

/// How many nodes an inspection lists.
pub const MOST_NODES_LISTED: usize = 1000;

fn node_message(index: u32, node: &ModelNode) -> pb::ModelNode {
    pb::ModelNode {
        index,
        name: node.name.clone(),
        joint: node.is_joint,
        position: node.world_from_node.translation.to_array().to_vec(),
    }
}

/// Reads a model and reports what the solver would use, without solving, and what the file holds beside its mesh, where its
/// format has such things.
///
/// # Errors
/// As [`Deformer::open`].
pub fn inspect(
    files: FileSet,
    create: &pb::CreateOptions,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
) -> Result<(pb::Inspection, Option<ModelContents>), Error> {
    let bench = Deformer::open(files, &open_options(create)?, limits, exec)?;
    let facts = session_message(&bench.facts());
    let report: &MeshReport = bench.report();
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let nodes = bench.model().nodes()?.unwrap_or_default();
    let renders = report.render_vertices - report.unreferenced_vertices;
    let inspection = pb::Inspection {
        components: count(report.parts.len()),
        boundary_loops: count(report.boundary_loops.len()),
        non_manifold_edges: count(report.non_manifold_edges),
        non_manifold_vertices: count(report.non_manifold_vertices),
        seam_vertices: count(renders.min(report.coincident_vertices)),
        closed: report.closed,
        box_min: report.bounds.min.to_array().to_vec(),
        box_max: report.bounds.max.to_array().to_vec(),
        area: report.area,
        volume: if report.closed { report.volume } else { 0.0 },
        memory_estimate: bench.estimate(),
        degenerate_faces: count(report.degenerate_triangles),
        duplicate_faces: count(report.duplicate_triangles),
        unreferenced_vertices: count(report.unreferenced_vertices),
        model: facts.model,
        primitives: facts.primitives,
        solver: facts.solver,
        warnings: facts.warnings,
        hard_parts: bench.hard_parts(),
        node_count: count(nodes.len()),
        nodes: (0..)
            .zip(&nodes)
            .take(MOST_NODES_LISTED)
            .map(|(index, node)| node_message(index, node))
            .collect(),
    };
    Ok((inspection, contents_of(bench.model())))
}

/// A clip of a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClipContents {
    /// What it is called; may be empty.
    pub name: String,
    /// When its last key is; `None` for a clip that cannot be read.
    pub seconds: Option<f64>,
}

/// A skin of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SkinContents {
    /// What it is called; may be empty.
    pub name: String,
    /// How many joints it has.
    pub joints: usize,
}

/// What a model holds beside its mesh, in the order of its file.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ModelContents {
    /// Its clips.
    pub clips: Vec<ClipContents>,
    /// Its skins.
    pub skins: Vec<SkinContents>,
    /// What its materials are called.
    pub materials: Vec<String>,
    /// What its pictures are called: by their names, else by their files, else by their media types.
    pub images: Vec<String>,
}

/// The lists of a glTF document that are reported.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct GltfLists {
    skins: Vec<Item>,
    materials: Vec<Item>,
    images: Vec<Item>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Item {
    name: String,
    uri: String,
    #[serde(rename = "mimeType")]
    media_type: String,
    joints: Vec<serde::de::IgnoredAny>,
}

impl Item {
    /// What a picture is called.
    fn picture_name(self) -> String {
        let is_file = !self.uri.is_empty() && !self.uri.starts_with("data:");
        match (self.name.is_empty(), is_file) {
            (false, _) => self.name,
            (true, true) => self.uri,
            (true, false) => self.media_type,
        }
    }
}

/// What a model holds beside its mesh; `None` for formats that hold no such things, or name them in other files.
pub fn contents_of(model: &Model) -> Option<ModelContents> {
    let scene = model.moving_scene().ok()??;
    // An FBX is read as the GLB that it would be written as.
    let written = match [Format::GLB, Format::GLTF].contains(&model.format) {
        true => None,
        false => Some(model.write(&model.positions, Format::GLB).ok()?.main),
    };
    let main = written.as_deref().unwrap_or(&model.files.main[..]);
    let document: GltfLists = serde_json::from_slice(document_text(main)).unwrap_or_default();
    let clips = scene.clip_names.into_iter().enumerate().map(|(index, name)| {
        let clip = model.scene_clip(index).ok().flatten();
        let seconds = clip.map(|clip| {
            let ends = clip.channels.iter().filter_map(|channel| channel.times.last());
            ends.fold(0.0, |longest: f64, end| longest.max(*end))
        });
        ClipContents { name, seconds }
    });
    let skins = document.skins.into_iter().map(|skin| SkinContents {
        joints: skin.joints.len(),
        name: skin.name,
    });
    Some(ModelContents {
        clips: clips.collect(),
        skins: skins.collect(),
        materials: document.materials.into_iter().map(|m| m.name).collect(),
        images: document.images.into_iter().map(Item::picture_name).collect(),
    })
}

/// The JSON of a GLB, or of a glTF, which is all JSON.
fn document_text(main: &[u8]) -> &[u8] {
    if !main.starts_with(b"glTF") {
        return main;
    }
    let length = main.get(12..16).and_then(|bytes| bytes.try_into().ok());
    let length = u32::from_le_bytes(length.unwrap_or_default()) as usize;
    main.get(20..).map_or(&[], |rest| rest.get(..length).unwrap_or(rest))
}
