//! Blend shapes of a document: morph targets of all that is drawn, in model space, joined by their names.

use super::accessors::ShapeAttribute;
use super::document::GltfDocument;
use super::moving::{MOST_TARGET_NUMBERS, scene_clip, target_moves};
use super::read::{GltfNotes, PlacedPrimitive};
use super::targets::{AttributeSlot, target_slots};
use super::text::{value_at, value_of};
use crate::files::within;
use crate::moving_scene::{BlendClip, BlendShape, BlendShapes, ChannelValues, SceneChannel};
use crate::{Error, Model};
use glam::Vec3;
use std::collections::BTreeMap;

/// The blend shapes of a model.
pub(super) fn read(model: &Model, notes: &GltfNotes) -> Result<BlendShapes, Error> {
    let doc = notes.loaded_document(model)?;
    let mut found = FoundShapes {
        shapes: BlendShapes::default(),
        numbers: BTreeMap::new(),
        of_node: BTreeMap::new(),
        vertices: model.positions.len(),
    };
    for row in &notes.rows {
        found.add_row(&doc, row)?;
    }
    if found.of_node.is_empty() {
        return Ok(found.shapes);
    }
    for index in 0..doc.animations.len() {
        let Some(clip) = scene_clip(model, notes, index)? else {
            continue;
        };
        let played = clip.channels.iter().filter_map(|channel| found.weights(channel));
        // Nodes that share shapes are played alike; the one that has most shapes says how.
        let most = played.reduce(|best, next| {
            if next.weights.len() > best.weights.len() {
                next
            } else {
                best
            }
        });
        found.shapes.clips.extend(most.map(|weights| BlendClip {
            name: clip.name,
            ..weights
        }));
    }
    Ok(found.shapes)
}

/// What is known while primitives are gone through.
struct FoundShapes {
    shapes: BlendShapes,
    /// The shape of a name, and of how often that name came before on the same mesh.
    numbers: BTreeMap<(String, usize), usize>,
    /// The shapes that the targets of a node are.
    of_node: BTreeMap<usize, Vec<usize>>,
    vertices: usize,
}

impl FoundShapes {
    fn add_row(&mut self, doc: &GltfDocument<'_>, row: &PlacedPrimitive) -> Result<(), Error> {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        let count = primitive.targets.len();
        if count == 0 {
            return Ok(());
        }
        let has = |role| {
            target_slots(primitive)
                .iter()
                .any(|slot: &AttributeSlot| slot.role == role)
        };
        self.shapes.has_normals |= has(ShapeAttribute::Normal);
        self.shapes.has_tangents |= has(ShapeAttribute::Tangent);
        let (mesh, node) = (doc.item(&doc.meshes, row.mesh), doc.item(&doc.nodes, row.node));
        let names = value_at(mesh, &["extras", "targetNames"]);
        let names: Vec<String> = names.and_then(|n| serde_json::from_str(n).ok()).unwrap_or_default();
        let weights = value_of(node, "weights").or_else(|| value_of(mesh, "weights"));
        let weights: Vec<f32> = weights.and_then(|w| serde_json::from_str(w).ok()).unwrap_or_default();
        let placed = row.placement.transforms(doc, primitive)?;
        let mut own: Vec<usize> = Vec::with_capacity(count);
        let mut met: BTreeMap<String, usize> = BTreeMap::new();
        for target in 0..count {
            let name = names.get(target).cloned().unwrap_or_else(|| format!("shape {target}"));
            let again = met.entry(name.clone()).or_default();
            let number = self.number(name, *again, weights.get(target).copied().unwrap_or(0.0))?;
            *again += 1;
            let shape = &mut self.shapes.shapes[number];
            let moves = target_moves(doc, primitive, target)?;
            for (k, (place, moves)) in shape.moves[row.vertices.clone()].iter_mut().zip(moves).enumerate() {
                *place = (placed.at(k).matrix3 * moves.as_dvec3()).as_vec3();
            }
            own.push(number);
        }
        let known = self.of_node.entry(row.node).or_default();
        if own.len() > known.len() {
            *known = own;
        }
        Ok(())
    }

    /// The number of a shape, which may be a new one.
    fn number(&mut self, name: String, again: usize, weight: f32) -> Result<usize, Error> {
        let next = self.shapes.shapes.len();
        let number = *self.numbers.entry((name.clone(), again)).or_insert(next);
        if number == next {
            let numbers = 3 * (self.vertices * (next + 1)) as u64;
            within("numbers of blend shapes", numbers, MOST_TARGET_NUMBERS)?;
            self.shapes.shapes.push(BlendShape {
                name,
                moves: vec![Vec3::ZERO; self.vertices],
                weight: if weight.is_finite() { weight } else { 0.0 },
            });
        }
        Ok(number)
    }

    /// What a channel does to shapes, without the name of its clip; `None` for one that moves something else.
    fn weights(&self, channel: &SceneChannel) -> Option<BlendClip> {
        let (ChannelValues::Weights(values), Some(shapes)) = (&channel.values, self.of_node.get(&channel.node)) else {
            return None;
        };
        Some(BlendClip {
            name: String::new(),
            times: channel.times.clone(),
            interpolation: channel.interpolation,
            weights: shapes.iter().copied().zip(values.iter().cloned()).collect(),
        })
    }
}
