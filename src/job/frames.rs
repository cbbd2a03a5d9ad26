//! Vertex buffers as frames: attributes, encodings, changed vertices and parts.
//!
//! Owns how positions, normals and tangents become the bytes of [`pb::Frame`] messages. A frame's parts are made one at a
//! time, when they are asked for, so that a slow reader costs no memory. Knows no stream and no session: who may get
//! a frame, and when, is not decided here.

use super::pb::{self, frame};
use crate::asset::{Model, Primitive};
use crate::mesh::shading;
use bytes::Bytes;
use glam::{DVec3, Vec3, Vec4};
use std::sync::Arc;

/// Digest of positions: `xxh3:` and 16 hexadecimal digits of the 64-bit XXH3 of x, y, z of each vertex as
/// little-endian 64-bit floats.
pub fn digest(positions: &[DVec3]) -> String {
    let mut hasher = xxhash_rust::xxh3::Xxh3::new();
    let mut block = [0u8; 24 * 64];
    for run in positions.chunks(64) {
        for (at, number) in block.chunks_exact_mut(8).zip(run.iter().flat_map(|p| p.to_array())) {
            at.copy_from_slice(&number.to_le_bytes());
        }
        hasher.update(&block[..run.len() * 24]);
    }
    format!("xxh3:{:016x}", hasher.digest())
}

/// Positions as little-endian 32-bit floats, x, y, z per vertex.
pub fn f32_bytes(positions: &[DVec3]) -> Bytes {
    let mut data = Vec::with_capacity(positions.len() * 12);
    positions
        .iter()
        .for_each(|p| put_f32(&mut data, &p.as_vec3().to_array()));
    data.into()
}

/// Normals and tangents of a shape, one per render vertex.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Shading {
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// Unit tangents with handedness; zero where the model has none.
    pub tangents: Vec<Vec4>,
}

/// What is needed of a model to shade its deformed shapes, apart from the model, so that it can be used while the
/// model is being solved.
#[derive(Debug, Clone, Default)]
pub struct Shader {
    rest: Arc<Vec<DVec3>>,
    triangles: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
    tangents: Vec<Vec4>,
    primitives: Vec<Primitive>,
}

impl Shader {
    /// Copies what shading needs.
    pub fn of(model: &Model, rest: &Arc<Vec<DVec3>>) -> Self {
        Self {
            rest: Arc::clone(rest),
            triangles: model.triangles.clone(),
            normals: model.normals.clone(),
            tangents: model.tangents.clone(),
            primitives: model.primitives.clone(),
        }
    }

    /// Normals and tangents of a deformed shape. See [`shading()`].
    pub fn shade(&self, positions: &[DVec3]) -> Shading {
        let authored = Authored {
            triangles: &self.triangles,
            normals: &self.normals,
            tangents: &self.tangents,
            primitives: &self.primitives,
        };
        shade(&authored, &self.rest, positions)
    }

    /// Bytes held, without the rest positions, which are shared.
    pub fn bytes(&self) -> u64 {
        let bytes = size_of_val(self.triangles.as_slice())
            + size_of_val(self.normals.as_slice())
            + size_of_val(self.tangents.as_slice())
            + size_of_val(self.primitives.as_slice());
        bytes as u64
    }
}

/// Normals and tangents of a model's deformed shape, one each per render vertex.
///
/// Authored normals and tangents follow the deformation. Primitives that came without normals get the smooth normals of the
/// deformed shape; without tangents, zeros.
pub fn shading(model: &Model, rest: &[DVec3], positions: &[DVec3]) -> Shading {
    let authored = Authored {
        triangles: &model.triangles,
        normals: &model.normals,
        tangents: &model.tangents,
        primitives: &model.primitives,
    };
    shade(&authored, rest, positions)
}

/// The part of a model that shading reads.
struct Authored<'a> {
    triangles: &'a [[u32; 3]],
    normals: &'a [Vec3],
    tangents: &'a [Vec4],
    primitives: &'a [Primitive],
}

fn shade(model: &Authored<'_>, rest: &[DVec3], positions: &[DVec3]) -> Shading {
    let count = positions.len();
    let gradients = if model.normals.len() == count && rest.len() == count {
        shading::gradients(rest, positions, model.triangles, model.triangles, count)
    } else {
        vec![None; count]
    };
    let authored = marked(model.primitives, count, |p| {
        p.has_normals && model.normals.len() == count
    });
    let mut normals = if authored.iter().all(|&a| a) && !authored.is_empty() {
        vec![Vec3::Z; count]
    } else {
        shading::smooth_normals(positions, model.triangles)
    };
    for v in (0..count).filter(|&v| authored[v]) {
        let normal = model.normals[v];
        normals[v] = gradients[v]
            .as_ref()
            .map_or(normal, |g| shading::carry_normal(g, normal));
    }
    let with_tangents = marked(model.primitives, count, |p| {
        p.has_tangents && model.tangents.len() == count
    });
    let mut tangents = vec![Vec4::ZERO; count];
    for v in (0..count).filter(|&v| with_tangents[v]) {
        let tangent = model.tangents[v];
        tangents[v] = gradients[v]
            .as_ref()
            .map_or(tangent, |g| shading::carry_tangent(g, tangent, normals[v]));
    }
    Shading { normals, tangents }
}

/// For every vertex, whether it lies in a primitive for which `holds` is true.
fn marked(primitives: &[Primitive], count: usize, holds: impl Fn(&Primitive) -> bool) -> Vec<bool> {
    let mut marks = vec![false; count];
    for p in primitives.iter().filter(|p| holds(p)) {
        let first = (p.first_vertex as usize).min(count);
        let end = first.saturating_add(p.vertex_count as usize).min(count);
        marks[first..end].fill(true);
    }
    marks
}

/// A frame to encode.
#[derive(Debug, Clone)]
pub struct FrameRequest {
    /// Everything but the numbers: seq, revision, final, errors and times. Parts copy it.
    pub header: pb::Frame,
    /// One per render vertex.
    pub positions: Arc<Vec<DVec3>>,
    /// Needed when `output` asks for normals or tangents; without it they are left out.
    pub shading: Option<Arc<Shading>>,
    /// What to send and how.
    pub output: pb::Output,
    /// With `output.changed_only`: the buffers that the reader may hold. A vertex is sent when it moved away from its
    /// place in any of them. Empty, or of another length: all vertices are sent.
    pub baselines: Vec<Arc<Vec<Vec3>>>,
    /// Length of the bounding box's diagonal, the unit of `output.changed_only`.
    pub diagonal: f64,
    /// Bytes that the data (and indices) of a part may take.
    pub part_bytes: usize,
}

/// Prepares a frame; the iterator makes its parts one by one.
///
/// There is always at least one part. Attributes follow one another: positions, then normals, then tangents.
pub fn encode(request: FrameRequest) -> Parts {
    let FrameRequest {
        header,
        positions,
        shading,
        output,
        baselines,
        diagonal,
        part_bytes,
    } = request;
    let selected = output
        .changed_only
        .map(|threshold| changed(&positions, &baselines, threshold * diagonal));
    let encoding = frame::Encoding::try_from(output.encoding).unwrap_or_default();
    let shading = shading.filter(|s| s.normals.len() == positions.len() && s.tangents.len() == positions.len());
    let vertices = selected.as_ref().map_or(positions.len(), Vec::len);
    let mut attributes = vec![frame::Attribute::Position];
    // An empty change is told by one empty part.
    if shading.is_some() && vertices > 0 {
        attributes.extend(output.normals.then_some(frame::Attribute::Normal));
        attributes.extend(output.tangents.then_some(frame::Attribute::Tangent));
    }
    let mut blocks = Vec::with_capacity(attributes.len());
    let mut parts = 0u32;
    for attribute in attributes {
        let numbers = if attribute == frame::Attribute::Tangent { 4 } else { 3 };
        let vertex_bytes = match encoding {
            frame::Encoding::F32 => numbers * 4,
            frame::Encoding::U16 => numbers * 2,
            // Four numbers of two bytes; what cannot be compressed grows by less than an eighth.
            frame::Encoding::Meshopt => 9,
        };
        let index_bytes = if selected.is_some() { 4 } else { 0 };
        let run = (part_bytes / (vertex_bytes + index_bytes)).max(1);
        let count = u32::try_from(vertices.div_ceil(run).max(1)).unwrap_or(u32::MAX);
        blocks.push(Block {
            attribute,
            first_part: parts,
            run,
        });
        parts = parts.saturating_add(count);
    }
    let bounds = if encoding == frame::Encoding::F32 {
        None
    } else {
        Some(bounds(&positions, selected.as_deref()))
    };
    Parts {
        header,
        positions,
        shading,
        selected,
        encoding,
        bounds,
        blocks,
        vertices,
        next: 0,
        parts,
    }
}

/// Vertices that lie further than `distance` from their place in any of the baselines, ascending.
fn changed(positions: &[DVec3], baselines: &[Arc<Vec<Vec3>>], distance: f64) -> Vec<u32> {
    let all = baselines.is_empty() || baselines.iter().any(|b| b.len() != positions.len());
    // Both sides are rounded alike, so that a vertex that rests has moved by exactly nothing.
    let moved = |v: usize, p: Vec3| {
        baselines
            .iter()
            .any(|b| (p.as_dvec3() - b[v].as_dvec3()).length() > distance)
    };
    let indices = positions
        .iter()
        .enumerate()
        .filter(|&(v, p)| all || moved(v, p.as_vec3()));
    indices.map(|(v, _)| v as u32).collect()
}

fn bounds(positions: &[DVec3], selected: Option<&[u32]>) -> [DVec3; 2] {
    let grow = |[low, high]: [DVec3; 2], p: DVec3| [low.min(p), high.max(p)];
    let nothing = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let [low, high] = match selected {
        Some(indices) => indices.iter().map(|&v| positions[v as usize]).fold(nothing, grow),
        None => positions.iter().copied().fold(nothing, grow),
    };
    if low.is_finite() && high.is_finite() {
        [low, high]
    } else {
        [DVec3::ZERO; 2]
    }
}

/// A run of parts with the same attribute.
#[derive(Debug)]
struct Block {
    attribute: frame::Attribute,
    first_part: u32,
    /// Vertices in every part but the last.
    run: usize,
}

/// The parts of one frame, in order, each made when it is asked for.
#[derive(Debug)]
pub struct Parts {
    header: pb::Frame,
    positions: Arc<Vec<DVec3>>,
    shading: Option<Arc<Shading>>,
    selected: Option<Vec<u32>>,
    encoding: frame::Encoding,
    bounds: Option<[DVec3; 2]>,
    blocks: Vec<Block>,
    vertices: usize,
    next: u32,
    parts: u32,
}

impl Parts {
    /// With `changed_only`: the vertices that the frame carries, ascending.
    pub fn selected(&self) -> Option<&[u32]> {
        self.selected.as_deref()
    }

    fn part(&self, part: u32) -> Option<pb::Frame> {
        let block = self.blocks.iter().rev().find(|b| b.first_part <= part)?;
        let first = (part - block.first_part) as usize * block.run;
        let end = first.saturating_add(block.run).min(self.vertices);
        let indices = self
            .selected
            .as_ref()
            .map(|s| s[first..end].to_vec())
            .unwrap_or_default();
        let vertex = |k: usize| self.selected.as_ref().map_or(k, |s| s[k] as usize);
        let [low, high] = match (self.bounds, block.attribute) {
            (Some(bounds), frame::Attribute::Position) => bounds,
            _ => [DVec3::NEG_ONE, DVec3::ONE],
        };
        let numbers = |k: usize| -> ([f64; 4], usize) {
            let v = vertex(k);
            match (block.attribute, &self.shading) {
                (frame::Attribute::Normal, Some(s)) => (s.normals[v].as_dvec3().extend(0.0).to_array(), 3),
                (frame::Attribute::Tangent, Some(s)) => (s.tangents[v].as_dvec4().to_array(), 4),
                _ => (self.positions[v].extend(0.0).to_array(), 3),
            }
        };
        let (lows, spans) = (low.extend(-1.0).to_array(), (high - low).extend(2.0).to_array());
        let quantised = |k: usize| -> ([u16; 4], usize) {
            let (values, n) = numbers(k);
            (
                std::array::from_fn(|i| {
                    if i < n {
                        quantise(values[i], lows[i], spans[i])
                    } else {
                        0
                    }
                }),
                n,
            )
        };
        let mut encoding = self.encoding;
        let mut data = Vec::new();
        if encoding == frame::Encoding::Meshopt && end > first {
            let vertices: Vec<[u16; 4]> = (first..end).map(|k| quantised(k).0.map(u16::to_le)).collect();
            match meshopt::encode_vertex_buffer(&vertices) {
                Ok(coded) if !coded.is_empty() => data = coded,
                // The encoding is told with every part, so a part that cannot be compressed goes as it is.
                _ => encoding = frame::Encoding::U16,
            }
        }
        match encoding {
            frame::Encoding::F32 => {
                data.reserve_exact((end - first) * 16);
                for k in first..end {
                    let (values, n) = numbers(k);
                    put_f32(&mut data, &values.map(|x| x as f32)[..n]);
                }
            }
            frame::Encoding::U16 => {
                for k in first..end {
                    let (values, n) = quantised(k);
                    values[..n]
                        .iter()
                        .for_each(|q| data.extend_from_slice(&q.to_le_bytes()));
                }
            }
            frame::Encoding::Meshopt => {}
        }
        let corner = |p: DVec3| {
            if self.bounds.is_some() {
                p.to_array().to_vec()
            } else {
                Vec::new()
            }
        };
        Some(pb::Frame {
            part,
            parts: self.parts,
            first_vertex: if self.selected.is_some() {
                indices.first().copied().unwrap_or(0)
            } else {
                u32::try_from(first).unwrap_or(u32::MAX)
            },
            vertex_count: u32::try_from(end - first).unwrap_or(u32::MAX),
            indices,
            encoding: encoding.into(),
            attribute: block.attribute.into(),
            data: data.into(),
            box_min: corner(low),
            box_max: corner(high),
            ..self.header.clone()
        })
    }
}

impl Iterator for Parts {
    type Item = pb::Frame;

    fn next(&mut self) -> Option<pb::Frame> {
        if self.next >= self.parts {
            return None;
        }
        let part = self.part(self.next)?;
        self.next += 1;
        Some(part)
    }
}

fn put_f32(data: &mut Vec<u8>, numbers: &[f32]) {
    numbers.iter().for_each(|x| data.extend_from_slice(&x.to_le_bytes()));
}

/// The nearest of 65536 steps from `low` over `span`; 0 on an axis without extent.
fn quantise(value: f64, low: f64, span: f64) -> u16 {
    if span > 0.0 {
        ((value - low) / span * 65535.0).round().clamp(0.0, 65535.0) as u16
    } else {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3Swizzles as _;
    use proptest::prelude::*;

    fn request(positions: Vec<DVec3>, encoding: frame::Encoding, part_bytes: usize) -> FrameRequest {
        FrameRequest {
            header: pb::Frame {
                seq: 7,
                revision: 3,
                r#final: true,
                ..Default::default()
            },
            positions: Arc::new(positions),
            shading: None,
            output: pb::Output {
                encoding: encoding.into(),
                ..Default::default()
            },
            baselines: Vec::new(),
            diagonal: 1.0,
            part_bytes,
        }
    }

    /// What a client makes of a frame: numbers per attribute by vertex, at most `numbers` each.
    fn decode(parts: &[pb::Frame], attribute: frame::Attribute) -> Vec<(u32, Vec<f64>)> {
        let n = if attribute == frame::Attribute::Tangent { 4 } else { 3 };
        let mut out = Vec::new();
        for part in parts.iter().filter(|p| p.attribute() == attribute) {
            let count = part.vertex_count as usize;
            let raw: Vec<Vec<f64>> = match part.encoding() {
                frame::Encoding::F32 => {
                    assert_eq!(part.data.len(), count * n * 4);
                    let numbers = part
                        .data
                        .chunks_exact(4)
                        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]).into());
                    numbers
                        .collect::<Vec<f64>>()
                        .chunks_exact(n)
                        .map(<[f64]>::to_vec)
                        .collect()
                }
                frame::Encoding::U16 => {
                    assert_eq!(part.data.len(), count * n * 2);
                    let numbers = part.data.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
                    numbers
                        .collect::<Vec<u16>>()
                        .chunks_exact(n)
                        .map(|v| unpack(part, v))
                        .collect()
                }
                frame::Encoding::Meshopt if count == 0 => Vec::new(),
                frame::Encoding::Meshopt => {
                    let coded: Vec<[u16; 4]> = meshopt::decode_vertex_buffer(&part.data, count).expect("decodes");
                    coded.iter().map(|v| unpack(part, &v[..n])).collect()
                }
            };
            let vertex = |k: usize| part.indices.get(k).copied().unwrap_or(part.first_vertex + k as u32);
            out.extend(raw.into_iter().enumerate().map(|(k, v)| (vertex(k), v)));
        }
        out
    }

    fn unpack(part: &pb::Frame, quantised: &[u16]) -> Vec<f64> {
        let low = |i: usize| if i < 3 { part.box_min[i] } else { -1.0 };
        let high = |i: usize| if i < 3 { part.box_max[i] } else { 1.0 };
        quantised
            .iter()
            .enumerate()
            .map(|(i, &q)| low(i) + f64::from(q) / 65535.0 * (high(i) - low(i)))
            .collect()
    }

    fn wave(count: usize) -> Vec<DVec3> {
        (0..count)
            .map(|i| DVec3::new(i as f64 * 0.37 - 4.0, libm::sin(i as f64), 2.5))
            .collect()
    }

    fn check_parts(parts: &[pb::Frame], part_bytes: usize) {
        for (k, part) in parts.iter().enumerate() {
            assert_eq!(
                (part.part as usize, part.parts as usize, part.seq, part.revision),
                (k, parts.len(), 7, 3)
            );
            assert!(
                part.r#final && part.data.len() + part.indices.len() * 4 <= part_bytes,
                "part {k} is too large"
            );
        }
    }

    #[test]
    fn digest_is_of_the_bits_in_order() {
        let (a, b) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.0, -0.0, 5.0));
        let bytes: Vec<u8> = [1.0f64, 2.0, 3.0, 0.0, -0.0, 5.0]
            .iter()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        assert_eq!(
            digest(&[a, b]),
            format!("xxh3:{:016x}", xxhash_rust::xxh3::xxh3_64(&bytes))
        );
        assert_ne!(
            digest(&[a, b]),
            digest(&[a, DVec3::new(0.0, 0.0, 5.0)]),
            "the sign of zero counts"
        );
        let long = wave(1000);
        let bytes: Vec<u8> = long
            .iter()
            .flat_map(|p| p.to_array())
            .flat_map(f64::to_le_bytes)
            .collect();
        assert_eq!(
            digest(&long),
            format!("xxh3:{:016x}", xxhash_rust::xxh3::xxh3_64(&bytes))
        );
    }

    #[test]
    fn float_parts_join_to_the_whole_buffer() {
        let positions = wave(1000);
        let parts: Vec<_> = encode(request(positions.clone(), frame::Encoding::F32, 1200)).collect();
        assert_eq!(parts.len(), 10);
        check_parts(&parts, 1200);
        let joined: Vec<u8> = parts.iter().flat_map(|p| p.data.to_vec()).collect();
        assert_eq!(joined, f32_bytes(&positions));
        assert!(parts.iter().all(|p| p.box_min.is_empty() && p.indices.is_empty()));
    }

    #[test]
    fn an_empty_model_and_a_tiny_part_still_make_frames() {
        assert_eq!(encode(request(Vec::new(), frame::Encoding::Meshopt, 1200)).count(), 1);
        let parts: Vec<_> = encode(request(wave(3), frame::Encoding::F32, 0)).collect();
        assert_eq!(parts.iter().map(|p| p.first_vertex).collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn an_axis_without_extent_is_kept_exactly() {
        for encoding in [frame::Encoding::U16, frame::Encoding::Meshopt] {
            let parts: Vec<_> = encode(request(wave(300), encoding, 1 << 20)).collect();
            assert!(
                decode(&parts, frame::Attribute::Position)
                    .iter()
                    .all(|(_, p)| p[2] == 2.5),
                "{encoding:?}"
            );
        }
    }

    #[test]
    fn normals_and_tangents_follow_as_blocks_of_their_own() {
        let positions = wave(500);
        let shading = Shading {
            normals: positions.iter().map(|p| p.as_vec3().normalize()).collect(),
            tangents: positions
                .iter()
                .map(|p| p.as_vec3().normalize().zxy().extend(-1.0))
                .collect(),
        };
        for encoding in [frame::Encoding::F32, frame::Encoding::U16, frame::Encoding::Meshopt] {
            let mut request = request(positions.clone(), encoding, 2000);
            request.shading = Some(Arc::new(shading.clone()));
            request.output.normals = true;
            request.output.tangents = true;
            let parts: Vec<_> = encode(request).collect();
            check_parts(&parts, 2000);
            let order: Vec<i32> = parts.iter().map(|p| p.attribute).collect();
            assert!(order.is_sorted() && order.first() == Some(&0) && order.last() == Some(&2));
            for (v, seen) in decode(&parts, frame::Attribute::Tangent) {
                let tangent = shading.tangents[v as usize].to_array();
                assert!(
                    seen.iter().zip(tangent).all(|(a, b)| (a - f64::from(b)).abs() < 2e-5),
                    "{encoding:?} {v}"
                );
            }
            assert_eq!(decode(&parts, frame::Attribute::Normal).len(), 500);
        }
    }

    #[test]
    fn only_vertices_that_left_some_baseline_are_sent() {
        let mut positions = wave(100);
        let rest: Vec<Vec3> = positions.iter().map(|p| p.as_vec3()).collect();
        let mut later = rest.clone();
        later[3].x += 1.0;
        positions[8].z += 0.5;
        positions[9].z += 0.05;
        let mut request = request(positions, frame::Encoding::F32, 64);
        request.output.changed_only = Some(0.1);
        request.baselines = vec![Arc::new(rest), Arc::new(later)];
        let parts: Vec<_> = encode(request.clone()).collect();
        let seen: Vec<u32> = decode(&parts, frame::Attribute::Position)
            .iter()
            .map(|(v, _)| *v)
            .collect();
        assert_eq!(seen, [3, 8]);
        assert_eq!(parts[0].indices, [3, 8]);

        request.output.changed_only = Some(2.0);
        request.output.normals = true;
        let parts: Vec<_> = encode(request.clone()).collect();
        assert_eq!(
            (parts.len(), parts[0].vertex_count, parts[0].data.len()),
            (1, 0, 0),
            "no change is one empty part"
        );

        request.baselines.clear();
        let all: Vec<u32> = encode(request).flat_map(|p| p.indices).collect();
        assert_eq!(
            all,
            (0..100).collect::<Vec<u32>>(),
            "a reader that holds nothing gets everything"
        );
    }

    #[test]
    fn shading_turns_with_the_shape_where_it_was_authored() {
        let rest = Arc::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::ZERO, DVec3::X, DVec3::Y]);
        let primitive = |first_vertex, authored| Primitive {
            first_vertex,
            vertex_count: 3,
            index_count: 3,
            has_normals: authored,
            has_tangents: authored,
            ..Primitive::default()
        };
        let bent = Vec3::new(0.6, 0.0, 0.8);
        let shader = Shader {
            rest: Arc::clone(&rest),
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            normals: [[bent; 3], [Vec3::ZERO; 3]].concat(),
            tangents: [[Vec4::new(0.0, 1.0, 0.0, -1.0); 3], [Vec4::ZERO; 3]].concat(),
            primitives: vec![primitive(0, true), primitive(3, false)],
        };
        let still = shader.shade(&rest);
        assert_eq!(
            (still.normals[0], still.normals[4]),
            (bent, Vec3::Z),
            "at rest the authored bits stay"
        );
        // A quarter turn about x takes y to z.
        let turned: Vec<DVec3> = rest.iter().map(|p| DVec3::new(p.x, -p.z, p.y)).collect();
        let shading = shader.shade(&turned);
        assert!((shading.normals[1] - Vec3::new(0.6, -0.8, 0.0)).length() < 1e-6);
        assert!((shading.tangents[1] - Vec4::new(0.0, 0.0, 1.0, -1.0)).length() < 1e-6);
        assert!((shading.normals[5] - Vec3::NEG_Y).length() < 1e-6);
        assert_eq!(shading.tangents[5], Vec4::ZERO);
    }

    proptest! {
        /// Every encoding gives every vertex back, once, within its stated error.
        #[test]
        fn encodings_keep_their_error(
            points in prop::collection::vec(prop::array::uniform3(-1e6f64..1e6), 1..400),
            encoding in 0i32..3,
            part_bytes in 0usize..3000,
        ) {
            let positions: Vec<DVec3> = points.iter().copied().map(DVec3::from_array).collect();
            let encoding = frame::Encoding::try_from(encoding).expect("0 to 2");
            let [low, high] = bounds(&positions, None);
            let parts: Vec<_> = encode(request(positions.clone(), encoding, part_bytes)).collect();
            if part_bytes >= 100 {
                check_parts(&parts, part_bytes);
            }
            let decoded = decode(&parts, frame::Attribute::Position);
            prop_assert_eq!(decoded.len(), positions.len());
            for (k, (v, seen)) in decoded.iter().enumerate() {
                prop_assert_eq!(*v as usize, k);
                for i in 0..3 {
                    let step = if encoding == frame::Encoding::F32 { 0.13 } else { (high - low)[i] / 65535.0 };
                    prop_assert!((seen[i] - positions[k][i]).abs() <= step * 0.5001);
                }
            }
        }
    }
}
