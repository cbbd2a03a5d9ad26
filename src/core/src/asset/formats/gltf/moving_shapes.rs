//! Where the vertices of primitives are stored, and what their morph targets do to them.

use super::accessors::ShapeAttribute;
use super::document::GltfDocument;
use super::placement::VertexTransforms;
use super::read::{GltfNotes, PlacedPrimitive};
use super::schema::MeshPrimitive;
use super::slots::AttributeSlot;
use super::targets::read_displacements;
use crate::asset::moving_scene::PrimitiveShapes;
use crate::asset::{Error, Model};
use glam::Vec3;
use std::collections::BTreeSet;

/// How many numbers the morph targets of one model may have together: nodes may share meshes and targets their numbers, so that
/// their size is not bounded by the file's.
const MOST_NUMBERS: u64 = 1 << 28;

/// The shapes of all primitives, in order.
pub(super) fn primitive_shapes(model: &Model, notes: &GltfNotes) -> Result<Vec<PrimitiveShapes>, Error> {
    let (doc, mut buffers) = notes.document_and_bytes(model)?;
    let mut numbers = 0;
    let mut all = Vec::with_capacity(notes.rows.len());
    for row in &notes.rows {
        let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
        numbers += 3 * (row.vertices.len() * (1 + primitive.targets.len())) as u64;
        if numbers > MOST_NUMBERS {
            return Err(Error::TooLarge {
                what: "numbers of morph targets",
                seen: numbers,
                limit: MOST_NUMBERS,
            });
        }
        let mut used: BTreeSet<usize> = row.placement.accessors(primitive).into_iter().collect();
        let position = primitive.attribute(ShapeAttribute::Position.name());
        used.extend(position);
        used.extend((0..primitive.targets.len()).filter_map(|t| displacements(t).accessor(primitive)));
        buffers.decode_for(&doc, &used)?;
        let placed = row.placement.transforms(&doc, &buffers, primitive)?;
        let mut shapes = PrimitiveShapes::default();
        if let Some(at) = position.filter(|_| row.skin.is_none()) {
            let stored = super::accessors::read_floats(&doc, &buffers, at, ShapeAttribute::Position)?;
            shapes.positions = vectors(&stored);
        }
        for target in 0..primitive.targets.len() {
            let moves = target_moves(&doc, &buffers, primitive, target)?;
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

fn target_moves(
    doc: &GltfDocument<'_>,
    buffers: &super::buffers::BufferBytes,
    primitive: &MeshPrimitive,
    target: usize,
) -> Result<Vec<Vec3>, Error> {
    let Some(accessor) = displacements(target).accessor(primitive) else {
        return Ok(Vec::new());
    };
    let moves = read_displacements(doc, buffers, accessor)?;
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
