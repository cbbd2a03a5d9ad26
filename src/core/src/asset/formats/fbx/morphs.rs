//! Blend shapes as morph targets.

use super::super::gltf::GlbWriter;
use super::corners::PartVertices;
use crate::asset::Error;
use serde_json::{Value, json};
use ufbx::{BlendChannel, BlendShape, Mesh, Vec3};

/// The channels of a mesh that become morph targets, in order; with them whether any in-between shape is left out.
pub(super) fn channels_of(mesh: &Mesh) -> (Vec<&BlendChannel>, bool) {
    let all = (&mesh.blend_deformers)
        .into_iter()
        .flat_map(|deformer| &deformer.channels);
    let channels: Vec<_> = all.filter(|channel| channel.target_shape.is_some()).collect();
    let has_between = channels.iter().any(|channel| channel.keyframes.len() > 1);
    (channels, has_between)
}

/// Whether shapes of a mesh turn normals as well.
fn turns_normals(channels: &[&BlendChannel]) -> bool {
    let shapes = channels.iter().filter_map(|channel| channel.target_shape.as_ref());
    shapes
        .into_iter()
        .any(|shape| shape.normal_offsets.iter().any(|&n| !is_zero(n)))
}

fn is_zero(v: Vec3) -> bool {
    v.x == 0.0 && v.y == 0.0 && v.z == 0.0
}

/// For each position of a mesh the vertices of a part that stand there.
struct VerticesAt {
    first: Vec<u32>,
    list: Vec<u32>,
}

impl VerticesAt {
    fn of_part(part: &PartVertices, positions: usize) -> Self {
        let mut first = vec![0u32; positions + 1];
        for &at in &part.control_point {
            first[at as usize + 1] += 1;
        }
        for i in 0..positions {
            first[i + 1] += first[i];
        }
        let mut next = first.clone();
        let mut list = vec![0; part.control_point.len()];
        for (vertex, &at) in part.control_point.iter().enumerate() {
            list[next[at as usize] as usize] = vertex as u32;
            next[at as usize] += 1;
        }
        Self { first, list }
    }

    fn of(&self, position: u32) -> &[u32] {
        match self.first.get(position as usize..position as usize + 2) {
            Some(&[from, to]) => &self.list[from as usize..to as usize],
            _ => &[],
        }
    }
}

/// Adds the morph targets of one primitive.
pub(super) fn add_targets(
    buffer: &mut GlbWriter,
    mesh: &Mesh,
    part: &PartVertices,
    channels: &[&BlendChannel],
    place: &str,
) -> Result<Vec<Value>, Error> {
    let with_normals = turns_normals(channels) && mesh.vertex_normal.exists;
    let vertices = VerticesAt::of_part(part, mesh.vertices.len());
    let mut targets = Vec::with_capacity(channels.len());
    for channel in channels {
        let Some(shape) = &channel.target_shape else { continue };
        let place = format!("{place}, blend shape \"{}\"", &*channel.element.name);
        let count = part.control_point.len();
        let (at, moved) = spread(shape, &shape.position_offsets, &vertices);
        let mut target = json!({"POSITION": buffer.add_displacements(count, &at, &moved, &place)?});
        if with_normals {
            let (at, turned) = spread(shape, &shape.normal_offsets, &vertices);
            target["NORMAL"] = json!(buffer.add_displacements(count, &at, &turned, &place)?);
        }
        targets.push(target);
    }
    Ok(targets)
}

/// The offsets of a shape as vertices of a part, in order and each once, with their values; without those that are zero.
fn spread(shape: &BlendShape, offsets: &[Vec3], vertices: &VerticesAt) -> (Vec<u32>, Vec<[f32; 3]>) {
    let pairs = shape.offset_vertices.iter().zip(offsets);
    let mut list: Vec<(u32, [f32; 3])> = pairs
        .filter(|(_, offset)| !is_zero(**offset))
        .flat_map(|(&at, offset)| {
            let value = [offset.x, offset.y, offset.z].map(|x| x as f32);
            vertices.of(at).iter().map(move |&vertex| (vertex, value))
        })
        .collect();
    list.sort_by_key(|(vertex, _)| *vertex);
    list.dedup_by_key(|(vertex, _)| *vertex);
    list.into_iter().unzip()
}
