//! Vertex buffers as frames: attributes, encodings, changed vertices and parts.
//!
//! Owns how positions, normals and tangents become the bytes of [`pb::Frame`] messages. A frame's parts are made one at a
//! time, when they are asked for, so that a slow reader costs no memory; where a part goes out as it is made, its numbers are
//! written straight into the bytes that are sent ([`OutgoingResponse`]). Knows no stream and no session: who may get
//! a frame, and when, is not decided here.

mod numbers;
mod outgoing;
mod part;

pub use outgoing::OutgoingResponse;
pub use part::FramePart;

use self::numbers::{PickedVertices, put_floats};
use self::part::{FrameVertices, bytes_a_vertex};
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
    put_floats(PickedVertices::Run(positions), &mut data);
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

/// Vertices from which on compressing a frame takes longer than who serves connections may be away.
const MANY_TO_COMPRESS: usize = 4096;

impl FrameRequest {
    /// Whether making its parts holds up a thread for long.
    pub fn is_slow_to_encode(&self) -> bool {
        let vertices = self.selected.as_ref().map_or(self.positions.len(), Vec::len);
        self.output.encoding == FrameEncoding::Meshopt && vertices > MANY_TO_COMPRESS
    }

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
    let has_shading = shading.is_some();
    let bounds = (encoding != frame::Encoding::F32).then(|| bounds(&positions, selected.as_deref()));
    let vertices = Arc::new(FrameVertices {
        positions,
        shading,
        selected,
        bounds,
    });
    // An empty change is told by one empty part.
    let shades = |wanted: bool| wanted && has_shading && vertices.count() > 0;
    let attributes = [
        (frame::Attribute::Position, true),
        (frame::Attribute::Normal, shades(output.normals)),
        (frame::Attribute::Tangent, shades(output.tangents)),
    ];
    let mut parts = 0u32;
    let blocks = attributes.map(|(attribute, is_sent)| {
        let index_bytes = if vertices.selected.is_some() { 4 } else { 0 };
        let run = (part_bytes / (bytes_a_vertex(encoding, attribute) + index_bytes)).max(1);
        let first_part = parts;
        if is_sent {
            let count = u32::try_from(vertices.count().div_ceil(run).max(1)).unwrap_or(u32::MAX);
            parts = parts.saturating_add(count);
        }
        FrameBlock {
            attribute,
            first_part,
            end_part: parts,
            run,
        }
    });
    FrameParts {
        header: header_message(&header),
        vertices,
        encoding,
        blocks,
        scratch: Vec::new(),
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

/// A run of parts with the same attribute; an attribute that is not sent has none.
#[derive(Debug)]
struct FrameBlock {
    attribute: frame::Attribute,
    first_part: u32,
    end_part: u32,
    /// Vertices in every part but the last.
    run: usize,
}

/// The parts of one frame, in order, each made when it is asked for.
#[derive(Debug)]
pub struct FrameParts {
    header: pb::Frame,
    vertices: Arc<FrameVertices>,
    encoding: frame::Encoding,
    blocks: [FrameBlock; 3],
    /// What meshopt is given.
    scratch: Vec<[u16; 4]>,
    next: u32,
    parts: u32,
}

impl FrameParts {
    /// Whether there is another part.
    pub fn has_more(&self) -> bool {
        self.next < self.parts
    }

    /// The next part, for who sends its bytes; as an iterator this gives messages.
    pub fn next_part(&mut self) -> Option<FramePart> {
        let part = self.next;
        let block = self
            .blocks
            .iter()
            .find(|b| (b.first_part..b.end_part).contains(&part))?;
        let first = (part - block.first_part) as usize * block.run;
        let end = first.saturating_add(block.run).min(self.vertices.count());
        let indices = self.vertices.selected.as_ref().map(|s| s[first..end].to_vec());
        let corners = self.vertices.bounds.map(|bounds| match block.attribute {
            frame::Attribute::Position => bounds,
            _ => [DVec3::NEG_ONE, DVec3::ONE],
        });
        let corner = |k: usize| corners.map(|c| c[k].to_array().to_vec()).unwrap_or_default();
        let first_vertex = match &indices {
            Some(indices) => indices.first().copied().unwrap_or(0),
            None => u32::try_from(first).unwrap_or(u32::MAX),
        };
        let head = pb::Frame {
            part,
            parts: self.parts,
            first_vertex,
            vertex_count: u32::try_from(end - first).unwrap_or(u32::MAX),
            indices: indices.unwrap_or_default(),
            encoding: self.encoding.into(),
            attribute: block.attribute.into(),
            box_min: corner(0),
            box_max: corner(1),
            ..self.header.clone()
        };
        self.next += 1;
        Some(FramePart::new(head, &self.vertices, first..end, &mut self.scratch))
    }
}

impl Iterator for FrameParts {
    type Item = pb::Frame;

    fn next(&mut self) -> Option<pb::Frame> {
        self.next_part().map(FramePart::into_message)
    }
}

#[cfg(test)]
mod tests;
