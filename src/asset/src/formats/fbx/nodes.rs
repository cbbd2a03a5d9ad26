//! The hierarchy of nodes, with their meshes and skins, and animation stacks as clips.

use super::super::gltf::GlbWriter;
use super::corners;
use super::meshes::{MeshSink, MeshSkin};
use super::scene::{FORMAT, MaterialTable, TranslationNotes, place_of, refuse, within_reserve};
use crate::Error;
use crate::files::ReadWatch;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use ufbx::{BakedAnim, BakedNode, BakedProp, BakedVec3, Mesh, Node, Scene, Transform};

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
        made.join_skeletons();
        report_other_kinds(scene, notes);
        Ok(made)
    }

    /// Puts the roots of skins whose joints have no node above them in common below one new node: glTF wants one, and vertices
    /// without weights follow the node of their mesh, which need not stand among the bones.
    fn join_skeletons(&mut self) {
        let mut parents: Vec<Option<usize>> = vec![None; self.nodes.len()];
        for (parent, node) in self.nodes.iter().enumerate() {
            for child in node["children"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(Value::as_u64)
            {
                parents[child as usize] = Some(parent);
            }
        }
        let root_of = |joint: u64| {
            let mut node = joint as usize;
            while let Some(parent) = parents[node] {
                node = parent;
            }
            node as u32
        };
        let mut apart = BTreeSet::new();
        for skin in &self.skins {
            let joints = skin["joints"].as_array().into_iter().flatten();
            let roots: BTreeSet<u32> = joints.filter_map(Value::as_u64).map(root_of).collect();
            if roots.len() > 1 {
                apart.extend(roots);
            }
        }
        if !apart.is_empty() {
            self.roots.retain(|root| !apart.contains(root));
            self.roots.push(self.nodes.len() as u32);
            self.nodes.push(json!({"name": "skeletons", "children": apart}));
        }
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
        let (channels, _) = corners::channels_of(mesh);
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

fn report_other_kinds(scene: &Scene, notes: &mut TranslationNotes) {
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

/// The longest clip that is sampled, in seconds: a day.
const LONGEST: f64 = 86_400.0;

/// Samples every animation stack that moves something. Failed ones are left out with a warning.
pub(super) fn sample_clips(
    scene: &Scene,
    nodes: &SceneNodes,
    buffer: &mut GlbWriter<'_>,
    notes: &mut TranslationNotes,
    watch: &ReadWatch<'_>,
) -> Result<Vec<Value>, Error> {
    let mut animations = Vec::new();
    for stack in &scene.anim_stacks {
        let place = place_of("animation", &stack.element);
        let length = stack.time_end - stack.time_begin;
        if !(length.is_finite() && length <= LONGEST) {
            let message = format!("lasts {length} s, at most {LONGEST} s are sampled: it is left out");
            notes.warn("fbx-clip", message, place);
            continue;
        }
        let (baked, reserved) = within_reserve(watch, 0, |allocator| {
            let options = ufbx::BakeOpts {
                temp_allocator: allocator(),
                result_allocator: allocator(),
                trim_start_time: true,
                key_reduction_enabled: true,
                key_reduction_rotation: true,
                ..Default::default()
            };
            ufbx::bake_anim(scene, &stack.anim, options).map_err(Box::new)
        })?;
        let baked = match baked {
            Ok(baked) => baked,
            Err(error) => {
                let message = format!("cannot be sampled ({}): it is left out", &*error.description).to_lowercase();
                notes.warn("fbx-clip", message, place);
                watch.release(reserved);
                continue;
            }
        };
        let mut clip = ClipBuilder {
            buffer,
            place: &place,
            samplers: Vec::new(),
            channels: Vec::new(),
        };
        for node in &baked.nodes {
            if let Some(number) = nodes.number_of.get(node.typed_id as usize).copied().flatten() {
                clip.add_node(node, number)?;
            }
        }
        for morphed in &nodes.morphed {
            clip.add_weights(&baked, morphed)?;
        }
        if !clip.channels.is_empty() {
            let mut json = json!({"samplers": clip.samplers, "channels": clip.channels});
            if !stack.element.name.is_empty() {
                json["name"] = json!(&*stack.element.name);
            }
            animations.push(json);
        }
        watch.release(reserved);
    }
    Ok(animations)
}

/// One clip in the making.
struct ClipBuilder<'a, 'w> {
    buffer: &'a mut GlbWriter<'w>,
    place: &'a str,
    samplers: Vec<Value>,
    channels: Vec<Value>,
}

impl ClipBuilder<'_, '_> {
    fn add_node(&mut self, baked: &BakedNode, node: u32) -> Result<(), Error> {
        let vectors = |keys: &[BakedVec3]| -> Vec<(f64, [f32; 3])> {
            let value = |key: &BakedVec3| [key.value.x, key.value.y, key.value.z].map(|x| x as f32);
            keys.iter().map(|key| (key.time, value(key))).collect()
        };
        self.add_channel(node, "translation", &vectors(&baked.translation_keys))?;
        let mut last = [0.0f32; 4];
        let rotations: Vec<(f64, [f32; 4])> = baked
            .rotation_keys
            .iter()
            .map(|key| {
                let q = [key.value.x, key.value.y, key.value.z, key.value.w].map(|x| x as f32);
                // Neighbours on one side of the sphere, so that the way between them is the short one.
                let dot: f32 = q.iter().zip(last).map(|(a, b)| a * b).sum();
                last = if dot < 0.0 { q.map(|x| -x) } else { q };
                (key.time, last)
            })
            .collect();
        self.add_channel(node, "rotation", &rotations)?;
        self.add_channel(node, "scale", &vectors(&baked.scale_keys))
    }

    /// Adds a channel; none without keys.
    fn add_channel<const N: usize>(&mut self, node: u32, path: &str, keys: &[(f64, [f32; N])]) -> Result<(), Error> {
        let (times, values) = ascending(keys);
        if times.is_empty() {
            return Ok(());
        }
        let output = self.buffer.add_floats(&values, self.place)?;
        self.push_channel(node, path, &times, output)
    }

    fn push_channel(&mut self, node: u32, path: &str, times: &[[f32; 1]], output: usize) -> Result<(), Error> {
        let input = self.buffer.add_bounded(times, self.place)?;
        self.samplers
            .push(json!({"input": input, "interpolation": "LINEAR", "output": output}));
        let sampler = self.samplers.len() - 1;
        self.channels
            .push(json!({"sampler": sampler, "target": {"node": node, "path": path}}));
        Ok(())
    }

    /// Adds the weights of a node's morph targets: all of them at every time at which one has a key.
    fn add_weights(&mut self, baked: &BakedAnim, morphed: &MorphedNode) -> Result<(), Error> {
        let tracks: Vec<Option<&BakedProp>> = morphed.channels.iter().map(|id| weight_track(baked, *id)).collect();
        let mut times: Vec<f64> = tracks
            .iter()
            .flatten()
            .flat_map(|track| track.keys.iter().map(|key| key.time))
            .collect();
        times.sort_by(f64::total_cmp);
        let keys: Vec<(f64, [f32; 0])> = times.iter().map(|&time| (time, [])).collect();
        let (times, _) = ascending(&keys);
        if times.is_empty() {
            return Ok(());
        }
        let mut values: Vec<[f32; 1]> = Vec::with_capacity(times.len() * tracks.len());
        let mut cursors = vec![0; tracks.len()];
        for [time] in &times {
            for ((track, cursor), rest) in tracks.iter().zip(&mut cursors).zip(&morphed.weights) {
                let percent = track.and_then(|track| value_at(&track.keys, cursor, f64::from(*time)));
                values.push([percent.map_or(*rest, |percent| (percent / 100.0) as f32)]);
            }
        }
        let output = self.buffer.add_floats(&values, self.place)?;
        self.push_channel(morphed.node, "weights", &times, output)
    }
}

/// The keys of the weight of a channel, in percent.
fn weight_track(baked: &BakedAnim, channel: u32) -> Option<&BakedProp> {
    let element = baked.elements.iter().find(|element| element.element_id == channel)?;
    let track = element.props.iter().find(|prop| &*prop.name == "DeformPercent");
    track.filter(|track| !track.keys.is_empty())
}

/// The value of a track on the line between two keys; `cursor` is the last key that was before the time asked for last.
fn value_at(keys: &[BakedVec3], cursor: &mut usize, time: f64) -> Option<f64> {
    while keys.get(*cursor + 1).is_some_and(|next| next.time <= time) {
        *cursor += 1;
    }
    let here = keys.get(*cursor)?;
    let Some(next) = keys
        .get(*cursor + 1)
        .filter(|next| next.time > here.time && time > here.time)
    else {
        return Some(here.value.x);
    };
    let part = (time - here.time) / (next.time - here.time);
    Some(here.value.x + part * (next.value.x - here.value.x))
}

/// Times and values with times from 0 on that rise in 32 bits, as glTF demands.
fn ascending<const N: usize>(keys: &[(f64, [f32; N])]) -> (Vec<[f32; 1]>, Vec<[f32; N]>) {
    let mut last = f32::NEG_INFINITY;
    let rising = keys.iter().filter_map(|(time, value)| {
        let time = time.max(0.0) as f32;
        let rises = time > last;
        last = last.max(time);
        rises.then_some(([time], *value))
    });
    rising.unzip()
}
