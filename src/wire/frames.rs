//! Vertex buffers as frames: attributes, encodings, changed vertices and parts.
//!
//! Owns how positions, normals and tangents become the bytes of [`pb::Frame`] messages. A frame's parts are made one at a
//! time, when they are asked for, so that a slow reader costs no memory. Knows no stream and no session: who may get
//! a frame, and when, is not decided here.

use super::facts::quality_message;
use super::pb::{self, frame};
use crate::engine::{QualityReport, Shading};
use crate::motion::rig::RigidMotion;
use bytes::Bytes;
use glam::DVec3;
use std::sync::Arc;

/// Positions as little-endian 32-bit floats, x, y, z per vertex.
pub fn f32_bytes(positions: &[DVec3]) -> Bytes {
    let mut data = Vec::with_capacity(positions.len() * 12);
    positions
        .iter()
        .for_each(|p| put_f32(&mut data, &p.as_vec3().to_array()));
    data.into()
}

/// What a frame tells beside its numbers. All its parts repeat it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrameHeader {
    /// The number of the pose that it shows.
    pub seq: u64,
    /// The session's revision.
    pub revision: u64,
    /// Whether it ends the work on its pose.
    pub is_final: bool,
    /// Relative residual reached.
    pub residual: f64,
    /// Estimated largest missing displacement, as a fraction of the diagonal.
    pub max_error: f64,
    /// Milliseconds of solving.
    pub solve_ms: f64,
    /// Milliseconds of waiting for a compute slot.
    pub queue_ms: f64,
    /// Poses that were skipped since the frame before.
    pub superseded: u32,
    /// How far the shape of a commit, or of a frame of an animation, is from the rest shape.
    pub quality: Option<QualityReport>,
    /// Which frame of an animation it is.
    pub animated: Option<Box<AnimatedHeader>>,
}

/// What a frame of an animation tells beside.
#[derive(Debug, Clone, PartialEq)]
pub struct AnimatedHeader {
    /// Its number.
    pub index: usize,
    /// Frames of the whole animation.
    pub count: usize,
    /// When it is, in seconds of the clip.
    pub seconds: f64,
    /// Where the root bone has carried the model, when that is not in the positions.
    pub root: RigidMotion,
    /// Digest of the positions as the root bone sees them.
    pub digest: String,
    /// Cycles of the solver.
    pub cycles: usize,
}

/// What frames carry, and how.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FrameOutput {
    /// Whether they carry normals.
    pub normals: bool,
    /// Whether they carry tangents.
    pub tangents: bool,
    /// They carry only vertices that have moved further than this, as a fraction of the diagonal; `None` is all vertices.
    pub changed_only: Option<f64>,
    /// How numbers are written.
    pub encoding: FrameEncoding,
    /// Whether the triangles that cross are counted on commit.
    pub self_intersections: bool,
}

/// How the numbers of a frame are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FrameEncoding {
    /// Little-endian 32-bit floats.
    #[default]
    F32,
    /// 16-bit steps of a box.
    U16,
    /// The same, compressed by meshopt.
    Meshopt,
}

impl FrameEncoding {
    pub(super) fn from_message(encoding: frame::Encoding) -> Self {
        match encoding {
            frame::Encoding::F32 => Self::F32,
            frame::Encoding::U16 => Self::U16,
            frame::Encoding::Meshopt => Self::Meshopt,
        }
    }

    pub(super) fn to_message(self) -> frame::Encoding {
        match self {
            Self::F32 => frame::Encoding::F32,
            Self::U16 => frame::Encoding::U16,
            Self::Meshopt => frame::Encoding::Meshopt,
        }
    }
}

/// A frame to encode.
#[derive(Debug, Clone)]
pub struct FrameRequest {
    /// Everything but the numbers.
    pub header: FrameHeader,
    /// One per render vertex.
    pub positions: Arc<Vec<DVec3>>,
    /// Needed when `output` asks for normals or tangents; without it they are left out.
    pub shading: Option<Arc<Shading>>,
    /// What to send and how.
    pub output: FrameOutput,
    /// The vertices to send, ascending; `None` is all of them.
    pub selected: Option<Vec<u32>>,
    /// Bytes that the data (and indices) of a part may take.
    pub part_bytes: usize,
}

impl FrameRequest {
    /// Bytes held, about.
    pub fn byte_size(&self) -> u64 {
        let shading = (self.shading.as_ref()).map_or(0, |s| s.normals.len() * 12 + s.tangents.len() * 16);
        let selected = self.selected.as_ref().map_or(0, |s| size_of_val(s.as_slice()));
        (size_of_val(self.positions.as_slice()) + shading + selected) as u64
    }
}

/// Prepares a frame; the iterator makes its parts one by one.
///
/// There is always at least one part. Attributes follow one another: positions, then normals, then tangents.
pub fn encode(request: FrameRequest) -> FrameParts {
    let FrameRequest {
        header,
        positions,
        shading,
        output,
        selected,
        part_bytes,
    } = request;
    let encoding = output.encoding.to_message();
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
        blocks.push(FrameBlock {
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
    FrameParts {
        header: header_message(&header),
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

fn header_message(header: &FrameHeader) -> pb::Frame {
    pb::Frame {
        seq: header.seq,
        revision: header.revision,
        r#final: header.is_final,
        residual: header.residual,
        max_error: header.max_error,
        solve_ms: header.solve_ms,
        queue_ms: header.queue_ms,
        superseded: header.superseded,
        quality: header.quality.as_ref().map(quality_message),
        animated: header.animated.as_deref().map(animated_message),
        ..Default::default()
    }
}

fn animated_message(header: &AnimatedHeader) -> pb::Animated {
    let narrow = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    pb::Animated {
        index: narrow(header.index),
        count: narrow(header.count),
        time: header.seconds,
        root_translation: header.root.place(DVec3::ZERO).to_array().to_vec(),
        root_rotation: header.root.rotation.to_array().to_vec(),
        digest: header.digest.clone(),
        cycles: narrow(header.cycles),
        ..Default::default()
    }
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
struct FrameBlock {
    attribute: frame::Attribute,
    first_part: u32,
    /// Vertices in every part but the last.
    run: usize,
}

/// The parts of one frame, in order, each made when it is asked for.
#[derive(Debug)]
pub struct FrameParts {
    header: pb::Frame,
    positions: Arc<Vec<DVec3>>,
    shading: Option<Arc<Shading>>,
    selected: Option<Vec<u32>>,
    encoding: frame::Encoding,
    bounds: Option<[DVec3; 2]>,
    blocks: Vec<FrameBlock>,
    vertices: usize,
    next: u32,
    parts: u32,
}

impl FrameParts {
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

impl Iterator for FrameParts {
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
mod tests;
