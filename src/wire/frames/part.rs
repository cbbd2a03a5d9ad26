//! One part of a frame, from its vertices to the bytes that are sent.

use super::Frame;
use super::numbers::{
    PickedVertices, Steps, VertexNumbers, push_padded_steps, put_floats, put_steps, take_differences,
};
use super::pb::{self, frame};
use bytes::BufMut;
use glam::DVec3;
use std::ops::Range;
use std::sync::Arc;

/// A run of the vertices that a frame sends.
#[derive(Debug)]
pub(super) struct VertexRun {
    pub frame: Arc<Frame>,
    /// Places among the vertices that are sent.
    pub range: Range<usize>,
    /// The box of positions that are sent as steps.
    pub corners: [DVec3; 2],
}

impl VertexRun {
    fn pick<'a, V>(&'a self, all: &'a [V]) -> PickedVertices<'a, V> {
        match &self.frame.selected {
            Some(selected) => PickedVertices::Listed {
                all,
                list: &selected[self.range.clone()],
            },
            None => PickedVertices::Run(&all[self.range.clone()]),
        }
    }
}

/// The box of positions, of those listed or of all; where they have none, both corners are the origin.
pub(super) fn bounds(positions: &[DVec3], selected: Option<&[u32]>) -> [DVec3; 2] {
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

/// A part of a frame. Its numbers stay where they are until it is sent.
#[derive(Debug)]
pub struct FramePart {
    /// Everything but the numbers.
    pub(super) head: pb::Frame,
    data: PartData,
}

#[derive(Debug)]
enum PartData {
    /// To be written from these vertices.
    Of(VertexRun),
    /// Encoded already: the length is not known before.
    Coded(Vec<u8>),
}

impl FramePart {
    /// The vertices of `run`, with header `head`. Meshopt data is encoded here, by way of `scratch`; on a stream with
    /// differences, `held` is what its reader has of these vertices.
    pub(super) fn new(
        mut head: pb::Frame,
        run: VertexRun,
        scratch: &mut Vec<[u16; 4]>,
        held: Option<&mut [[u16; 4]]>,
    ) -> Self {
        let is_coded = matches!(head.encoding(), frame::Encoding::Meshopt | frame::Encoding::Delta);
        if is_coded && !run.range.is_empty() {
            scratch.clear();
            scratch.reserve_exact(run.range.len());
            let corners = run.corners;
            visit(head.attribute(), &run, PadSteps { corners, out: scratch });
            match held {
                Some(held) if head.encoding() == frame::Encoding::Delta => take_differences(scratch, held),
                Some(held) => held.copy_from_slice(scratch),
                None => {}
            }
            match meshopt::encode_vertex_buffer(scratch) {
                Ok(coded) if !coded.is_empty() => {
                    let data = PartData::Coded(coded);
                    return Self { head, data };
                }
                // Every part names its encoding, so a part that cannot be compressed is sent uncompressed.
                _ => head.set_encoding(frame::Encoding::U16),
            }
        }
        let data = PartData::Of(run);
        Self { head, data }
    }

    /// How its numbers are written.
    pub fn encoding(&self) -> frame::Encoding {
        self.head.encoding()
    }

    /// Bytes of numbers.
    pub fn data_bytes(&self) -> usize {
        match &self.data {
            PartData::Coded(coded) => coded.len(),
            PartData::Of(run) => run.range.len() * bytes_a_vertex(self.head.encoding(), self.head.attribute()),
        }
    }

    /// Everything but the numbers.
    pub(super) fn head(&self) -> &pb::Frame {
        &self.head
    }

    /// Writes the numbers.
    pub(super) fn write_data(&self, out: &mut impl BufMut) {
        match &self.data {
            PartData::Coded(coded) => out.put_slice(coded),
            PartData::Of(run) => {
                let (corners, attribute) = (run.corners, self.head.attribute());
                match self.head.encoding() {
                    frame::Encoding::F32 => visit(attribute, run, PutFloats(out)),
                    frame::Encoding::U16 => visit(attribute, run, PutSteps { corners, out }),
                    // Coded, unless it is empty.
                    frame::Encoding::Meshopt | frame::Encoding::Delta => {}
                }
            }
        }
    }

    /// The part as a message that holds its numbers.
    pub fn into_message(self) -> pb::Frame {
        let data = match self.data {
            PartData::Coded(coded) => coded,
            PartData::Of(_) => {
                let mut data = Vec::with_capacity(self.data_bytes());
                self.write_data(&mut data);
                data
            }
        };
        pb::Frame {
            data: data.into(),
            ..self.head
        }
    }
}

/// Bytes that a vertex takes, at most.
pub(super) fn bytes_a_vertex(encoding: frame::Encoding, attribute: frame::Attribute) -> usize {
    let numbers = if attribute == frame::Attribute::Tangent { 4 } else { 3 };
    match encoding {
        frame::Encoding::F32 => numbers * 4,
        frame::Encoding::U16 => numbers * 2,
        // Four numbers of two bytes; what cannot be compressed grows by less than an eighth.
        frame::Encoding::Meshopt | frame::Encoding::Delta => 9,
    }
}

/// What is done with vertices of whatever kind.
trait VertexVisitor {
    /// Takes them; numbers of directions lie between -1 and 1.
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, are_directions: bool);
}

fn visit(attribute: frame::Attribute, run: &VertexRun, visitor: impl VertexVisitor) {
    match (attribute, &run.frame.shading) {
        (frame::Attribute::Normal, Some(s)) => visitor.take(run.pick(&s.normals), true),
        (frame::Attribute::Tangent, Some(s)) => visitor.take(run.pick(&s.tangents), true),
        _ => visitor.take(run.pick(&run.frame.positions), false),
    }
}

struct PutFloats<'a, B>(&'a mut B);

impl<B: BufMut> VertexVisitor for PutFloats<'_, B> {
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, _: bool) {
        put_floats(vertices, self.0);
    }
}

struct PutSteps<'a, B> {
    corners: [DVec3; 2],
    out: &'a mut B,
}

impl<B: BufMut> VertexVisitor for PutSteps<'_, B> {
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, are_directions: bool) {
        put_steps(vertices, &steps_of(self.corners, are_directions), self.out);
    }
}

struct PadSteps<'a> {
    corners: [DVec3; 2],
    out: &'a mut Vec<[u16; 4]>,
}

impl VertexVisitor for PadSteps<'_> {
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, are_directions: bool) {
        push_padded_steps(vertices, &steps_of(self.corners, are_directions), self.out);
    }
}

fn steps_of<const N: usize>([low, high]: [DVec3; 2], are_directions: bool) -> Steps<N> {
    if are_directions {
        return Steps::between([-1.0; N], [1.0; N]);
    }
    let of = |corner: DVec3| std::array::from_fn(|k| corner.to_array().get(k).copied().unwrap_or(0.0));
    Steps::between(of(low), of(high))
}
