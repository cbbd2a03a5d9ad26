//! The hierarchy of nodes, with their meshes and skins.

use super::super::gltf::GlbWriter;
use super::fault::{FORMAT, place_of, refuse};
use super::materials::MaterialTable;
use super::meshes::MeshSink;
use super::morphs;
use super::notes::TranslationNotes;
use super::skins::MeshSkin;
use crate::asset::Error;
use crate::asset::files::ReadWatch;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use ufbx::{Mesh, Node, Scene, Transform};

/// The nodes of the asset and what hangs on them.
pub(super) struct SceneNodes {
    pub nodes: Vec<Value>,
    pub meshes: Vec<Value>,
    pub skins: Vec<Value>,
    /// The nodes of the scene that have no parent.
    pub roots: Vec<u32>,
    /// For each node of the file its number in the asset.
    pub number_of: Vec<Option<u32>>,
    /// The nodes whose meshes have morph targets.
    pub morphed: Vec<MorphedNode>,
}

/// A node whose mesh has morph targets.
pub(super) struct MorphedNode {
    /// Its number in the asset.
    pub node: u32,
    /// For each target the number of its channel among the elements of the file.
    pub channels: Vec<u32>,
    /// For each target its weight where nothing moves it.
    pub weights: Vec<f32>,
}

impl SceneNodes {
    /// Puts nodes, meshes and skins of a file into an asset.
    pub(super) fn build(
        scene: &Scene,
        buffer: &mut GlbWriter<'_>,
        materials: &mut MaterialTable<'_>,
        notes: &mut TranslationNotes,
        watch: &ReadWatch<'_>,
    ) -> Result<Self, Error> {
        let mut made = Self::hierarchy(scene)?;
        let mut meshes: BTreeMap<(u32, Vec<u32>), Option<usize>> = BTreeMap::new();
        let mut skins: BTreeMap<u32, usize> = BTreeMap::new();
        let mut sink = MeshSink {
            buffer,
            materials,
            notes,
            watch,
            vertices: 0,
            triangles: 0,
        };
        for node in &scene.nodes {
            let (Some(mesh), Some(number)) = (&node.mesh, made.number(node)) else {
                continue;
            };
            let skin = MeshSkin::of_mesh(mesh, sink.notes)?;
            let looks = node.materials.iter().map(|m| m.element.typed_id).collect();
            let key = (mesh.element.typed_id, looks);
            let known = if let Some(known) = meshes.get(&key) {
                *known
            } else {
                let json = sink.add_mesh(mesh, node, skin.as_ref())?;
                let added = json.map(|json| {
                    made.meshes.push(json);
                    made.meshes.len() - 1
                });
                meshes.insert(key, added);
                added
            };
            let Some(mesh_number) = known else { continue };
            made.nodes[number as usize]["mesh"] = json!(mesh_number);
            made.note_morphs(mesh, number);
            let Some(skin) = skin else { continue };
            let shared = skins.get(&mesh.element.typed_id).filter(|_| !skin.names_own_node());
            let skin_number = if let Some(shared) = shared {
                *shared
            } else {
                let (joints, json) = skin.add_skin(sink.buffer, node.element.typed_id)?;
                let added = made.add_skin(&joints, json);
                skins.insert(mesh.element.typed_id, added);
                added
            };
            made.nodes[number as usize]["skin"] = json!(skin_number);
        }
        if made.meshes.is_empty() {
            let (nodes, meshes) = (scene.nodes.len(), scene.meshes.len());
            return Err(Error::NoMesh {
                format: FORMAT,
                problem: format!("{nodes} nodes, {meshes} meshes and no polygon that a node shows"),
            });
        }
        tell_of_other_kinds(scene, notes);
        Ok(made)
    }

    /// The nodes with their names, places and children, and nothing else.
    fn hierarchy(scene: &Scene) -> Result<Self, Error> {
        let root = &scene.root_node;
        let skips_root = is_identity(&root.local_transform) && root.mesh.is_none();
        let mut number_of = vec![None; scene.nodes.len()];
        let mut next = 0;
        for (i, node) in scene.nodes.iter().enumerate() {
            if !(skips_root && node.is_root) {
                number_of[i] = Some(next);
                next += 1;
            }
        }
        let mut made = Self {
            nodes: Vec::with_capacity(next as usize),
            meshes: Vec::new(),
            skins: Vec::new(),
            roots: Vec::new(),
            number_of,
            morphed: Vec::new(),
        };
        for node in &scene.nodes {
            let children: Vec<u32> = node.children.iter().filter_map(|child| made.number(child)).collect();
            if made.number(node).is_none() {
                made.roots = children;
                continue;
            }
            let mut json = transform_json(&node.local_transform)
                .ok_or_else(|| refuse(place_of("node", &node.element), "its transform is not finite"))?;
            if !node.element.name.is_empty() {
                json["name"] = json!(&*node.element.name);
            }
            if !children.is_empty() {
                json["children"] = json!(children);
            }
            made.nodes.push(json);
            if node.is_root {
                made.roots = vec![made.nodes.len() as u32 - 1];
            }
        }
        Ok(made)
    }

    /// The number of a node in the asset.
    fn number(&self, node: &Node) -> Option<u32> {
        self.number_of.get(node.element.typed_id as usize).copied().flatten()
    }

    fn note_morphs(&mut self, mesh: &Mesh, node: u32) {
        let (channels, _) = morphs::channels_of(mesh);
        if !channels.is_empty() {
            self.morphed.push(MorphedNode {
                node,
                channels: channels.iter().map(|channel| channel.element.element_id).collect(),
                weights: channels.iter().map(|channel| channel.weight as f32).collect(),
            });
        }
    }

    /// Adds a skin over joints, given as nodes of the file. A node that is named twice gets a child to stand for it, for
    /// glTF has each joint once.
    fn add_skin(&mut self, joints: &[u32], mut json: Value) -> usize {
        let mut seen = BTreeSet::new();
        let mut numbers = Vec::with_capacity(joints.len());
        for &joint in joints {
            let number = self.number_of.get(joint as usize).copied().flatten();
            let number = number.filter(|number| seen.insert(*number)).unwrap_or_else(|| {
                let child = self.nodes.len() as u32;
                self.nodes.push(json!({}));
                let Some(parent) = number else {
                    // The root, which stands nowhere else than the scene does.
                    self.roots.push(child);
                    return child;
                };
                match &mut self.nodes[parent as usize]["children"] {
                    Value::Array(children) => children.push(json!(child)),
                    none => *none = json!([child]),
                }
                child
            });
            numbers.push(number);
        }
        json["joints"] = json!(numbers);
        self.skins.push(json);
        self.skins.len() - 1
    }
}

fn is_identity(transform: &Transform) -> bool {
    transform_json(transform).is_some_and(|json| json.as_object().is_some_and(serde_json::Map::is_empty))
}

/// The members of a node that place it, without those that say nothing; `None` where one is not finite.
fn transform_json(transform: &Transform) -> Option<Value> {
    let Transform {
        translation: t,
        rotation: r,
        scale: s,
    } = transform;
    let mut json = json!({});
    let size = (r.x * r.x + r.y * r.y + r.z * r.z + r.w * r.w).sqrt();
    let lists: [(&str, &[f64], &[f64]); 3] = [
        ("translation", &[t.x, t.y, t.z], &[0.0; 3]),
        (
            "rotation",
            &[r.x, r.y, r.z, r.w].map(|x| x / size),
            &[0.0, 0.0, 0.0, 1.0],
        ),
        ("scale", &[s.x, s.y, s.z], &[1.0; 3]),
    ];
    for (key, values, neutral) in lists {
        if values.iter().any(|v| !(*v as f32).is_finite()) {
            return None;
        }
        if values != neutral {
            json[key] = json!(values);
        }
    }
    Some(json)
}

fn tell_of_other_kinds(scene: &Scene, notes: &mut TranslationNotes) {
    let kinds = [
        (scene.cameras.len(), "cameras"),
        (scene.lights.len(), "lights"),
        (
            scene.nurbs_curves.len() + scene.nurbs_surfaces.len() + scene.line_curves.len(),
            "curves and NURBS surfaces",
        ),
        (scene.cache_deformers.len(), "geometry caches"),
        (scene.constraints.len(), "constraints"),
    ];
    for (count, what) in kinds {
        if count > 0 {
            notes.leave_out(what);
        }
    }
}
