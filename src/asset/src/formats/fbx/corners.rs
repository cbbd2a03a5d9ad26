//! Vertices of a mesh whose polygons number positions, normals, texture coordinates and colours apart.
//!
//! A vertex is made for each combination that occurs, in the order in which polygons name them, so corners with the same
//! values share one even where the file counts them apart.

use super::super::gltf::GlbWriter;
use super::super::polygons::Polygons;
use crate::Error;
use crate::geometry::PlacesByVertex;
use glam::DVec3;
use serde_json::{Value, json};
use ufbx::{BlendChannel, BlendShape, Mesh, MeshPart, Vec3};

/// An attribute of corners: for a place in the mesh's corners its value.
pub(super) type CornerAttribute<'a, const N: usize> = Box<dyn Fn(u32) -> [f32; N] + 'a>;

/// What every corner of a mesh has beyond its position.
pub(super) struct FbxCornerAttributes<'a> {
    pub normal: Option<CornerAttribute<'a, 3>>,
    pub uv: Vec<CornerAttribute<'a, 2>>,
    pub colours: Vec<CornerAttribute<'a, 4>>,
}

/// How many sets of texture coordinates or colours come along.
const MOST_SETS: usize = 8;

impl<'a> FbxCornerAttributes<'a> {
    /// The attributes of a mesh. Texture coordinates count from the upper left corner of the picture, as glTF has it.
    pub(super) fn of_mesh(mesh: &'a Mesh) -> Self {
        let uv = mesh.uv_sets.iter().filter(|set| set.vertex_uv.exists).take(MOST_SETS);
        let colours = mesh
            .color_sets
            .iter()
            .filter(|set| set.vertex_color.exists)
            .take(MOST_SETS);
        Self {
            normal: mesh.vertex_normal.exists.then(|| {
                boxed(move |corner| {
                    let v = value_at(&mesh.vertex_normal.values, &mesh.vertex_normal.indices, corner);
                    v.map_or([0.0; 3], |v| [v.x, v.y, v.z].map(plain))
                })
            }),
            uv: uv
                .map(|set| {
                    boxed(move |corner| {
                        let v = value_at(&set.vertex_uv.values, &set.vertex_uv.indices, corner);
                        v.map_or([0.0; 2], |v| [v.x, 1.0 - v.y].map(plain))
                    })
                })
                .collect(),
            colours: colours
                .map(|set| {
                    boxed(move |corner| {
                        let v = value_at(&set.vertex_color.values, &set.vertex_color.indices, corner);
                        v.map_or([1.0; 4], |v| [v.x, v.y, v.z, v.w].map(plain))
                    })
                })
                .collect(),
        }
    }
}

fn boxed<'a, const N: usize>(f: impl Fn(u32) -> [f32; N] + 'a) -> CornerAttribute<'a, N> {
    Box::new(f)
}

fn value_at<'a, T>(values: &'a [T], indices: &[u32], corner: u32) -> Option<&'a T> {
    values.get(*indices.get(corner as usize)? as usize)
}

/// A number in 32 bits, without a sign where it is zero.
fn plain(value: f64) -> f32 {
    value as f32 + 0.0
}

/// The vertices and triangles of the faces of one material.
#[derive(Default)]
pub(super) struct PartVertices {
    /// For each vertex a corner of the mesh that has its values.
    pub corner: Vec<u32>,
    /// For each vertex the position of the mesh that it stands at.
    pub control_point: Vec<u32>,
    pub triangles: Vec<[u32; 3]>,
    /// How many faces were too large to cut well.
    pub crude: usize,
}

/// The faces of a part as places in the mesh's corners, without holes and with what they stand on in range.
fn faces_of<'a>(mesh: &'a Mesh, part: &'a MeshPart) -> impl Iterator<Item = std::ops::Range<u32>> + 'a {
    let is_hole = |face: u32| mesh.face_hole.get(face as usize).copied().unwrap_or(false);
    let faces = part.face_indices.iter().filter(move |&&face| !is_hole(face));
    faces.filter_map(|&face| {
        let face = mesh.faces.get(face as usize)?;
        let end = face.index_begin.checked_add(face.num_indices)?;
        let is_face = face.num_indices >= 3 && end as usize <= mesh.vertex_indices.len();
        is_face.then_some(face.index_begin..end)
    })
}

/// How many triangles the faces of a part give.
pub(super) fn triangle_count(mesh: &Mesh, part: &MeshPart) -> u64 {
    faces_of(mesh, part).map(|face| face.len() as u64 - 2).sum()
}

/// Cuts the faces of a part into triangles and makes its vertices.
///
/// # Errors
/// Those of `check`, which is called every few milliseconds.
pub(super) fn divide(
    mesh: &Mesh,
    part: &MeshPart,
    attributes: &FbxCornerAttributes<'_>,
    check: impl Fn() -> Result<(), Error>,
) -> Result<PartVertices, Error> {
    let mut polygons = Polygons::default();
    let mut corners: Vec<u32> = Vec::new();
    for face in faces_of(mesh, part) {
        let own = &mesh.vertex_indices.as_ref()[face.start as usize..face.end as usize];
        if own.iter().all(|&v| (v as usize) < mesh.vertices.len()) {
            polygons.corners.extend_from_slice(own);
            polygons.end_face();
            corners.extend(face);
        }
    }
    let points: Vec<DVec3> = mesh.vertices.iter().map(|p| DVec3::new(p.x, p.y, p.z)).collect();
    let (slots, crude) = polygons.triangulate(&points, check)?;

    let mut ids = polygons.corners.clone();
    split(&mut ids, corners.iter().map(|_| [0u32; 1]));
    let bits = |values: &CornerAttribute<'_, 2>, corner: u32| values(corner).map(f32::to_bits);
    for set in &attributes.uv {
        split(&mut ids, corners.iter().map(|&c| bits(set, c)));
    }
    for set in &attributes.colours {
        split(&mut ids, corners.iter().map(|&c| set(c).map(f32::to_bits)));
    }
    if let Some(normal) = &attributes.normal {
        split(&mut ids, corners.iter().map(|&c| normal(c).map(f32::to_bits)));
    }
    let mut made = PartVertices {
        triangles: slots.iter().map(|t| t.map(|slot| ids[slot as usize])).collect(),
        crude,
        ..Default::default()
    };
    for (slot, &id) in ids.iter().enumerate() {
        // Numbers are given in the order of first use, so a new one is the next.
        if id as usize == made.corner.len() {
            made.corner.push(corners[slot]);
            made.control_point.push(polygons.corners[slot]);
        }
    }
    Ok(made)
}

/// Gives corners of one class with different values different numbers, counted by first use.
fn split<const N: usize>(ids: &mut [u32], values: impl Iterator<Item = [u32; N]>) {
    let keys: Vec<(u32, [u32; N])> = ids.iter().copied().zip(values).collect();
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    order.sort_by_key(|&corner| (keys[corner as usize], corner));
    // The first corner of each class stands for it.
    let mut first_of = vec![0; keys.len()];
    let mut first = 0;
    for (place, &corner) in order.iter().enumerate() {
        let begins = place == 0 || keys[order[place - 1] as usize] != keys[corner as usize];
        first = if begins { corner } else { first };
        first_of[corner as usize] = first;
    }
    let mut next = 0;
    for corner in 0..ids.len() {
        let first = first_of[corner] as usize;
        if first == corner {
            ids[corner] = next;
            next += 1;
        } else {
            ids[corner] = ids[first];
        }
    }
}

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

/// Adds the morph targets of one primitive.
pub(super) fn add_targets(
    buffer: &mut GlbWriter,
    mesh: &Mesh,
    part: &PartVertices,
    channels: &[&BlendChannel],
    place: &str,
) -> Result<Vec<Value>, Error> {
    let with_normals = turns_normals(channels) && mesh.vertex_normal.exists;
    let vertices = PlacesByVertex::of(mesh.vertices.len(), &part.control_point);
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
fn spread(shape: &BlendShape, offsets: &[Vec3], vertices: &PlacesByVertex) -> (Vec<u32>, Vec<[f32; 3]>) {
    let pairs = shape.offset_vertices.iter().zip(offsets);
    let mut list: Vec<(u32, [f32; 3])> = pairs
        .filter(|(_, offset)| !is_zero(**offset))
        .flat_map(|(&at, offset)| {
            let value = [offset.x, offset.y, offset.z].map(|x| x as f32);
            vertices.at(at).iter().map(move |&vertex| (vertex, value))
        })
        .collect();
    list.sort_by_key(|(vertex, _)| *vertex);
    list.dedup_by_key(|(vertex, _)| *vertex);
    list.into_iter().unzip()
}
