//! One part of a frame, from its vertices to the bytes that are sent.

use super::numbers::{
    PickedVertices, Steps, VertexNumbers, push_padded_steps, put_floats, put_steps, take_differences,
};
use super::pb::{self, frame};
use crate::engine::Shading;
use bytes::BufMut;
use glam::DVec3;
use std::ops::Range;
use std::sync::Arc;

/// What the parts of a frame take their numbers from.
#[derive(Debug)]
pub(super) struct FrameVertices {
    pub positions: Arc<Vec<DVec3>>,
    pub shading: Option<Arc<Shading>>,
    /// The vertices to send, ascending; `None` is all of them.
    pub selected: Option<Vec<u32>>,
    /// The box of positions that are sent as steps.
    pub bounds: Option<[DVec3; 2]>,
}

impl FrameVertices {
    /// How many vertices are sent.
    pub fn count(&self) -> usize {
        self.selected.as_ref().map_or(self.positions.len(), Vec::len)
    }

    fn pick<'a, V>(&'a self, all: &'a [V], range: &Range<usize>) -> PickedVertices<'a, V> {
        match &self.selected {
            Some(selected) => PickedVertices::Listed {
                all,
                list: &selected[range.clone()],
            },
            None => PickedVertices::Run(&all[range.clone()]),
        }
    }

    fn corners(&self) -> [DVec3; 2] {
        self.bounds.unwrap_or([DVec3::NEG_ONE, DVec3::ONE])
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
    Of(Arc<FrameVertices>, Range<usize>),
    /// Encoded already: the length is not known before.
    Coded(Vec<u8>),
}

impl FramePart {
    /// The vertices in `range`, with header `head`. Meshopt data is encoded here, by way of `scratch`; on a stream with
    /// differences, `held` is what its reader has of these vertices.
    pub(super) fn new(
        mut head: pb::Frame,
        vertices: &Arc<FrameVertices>,
        range: Range<usize>,
        (scratch, held): (&mut Vec<[u16; 4]>, Option<&mut [[u16; 4]]>),
    ) -> Self {
        let mut data = PartData::Of(Arc::clone(vertices), range.clone());
        let is_coded = matches!(head.encoding(), frame::Encoding::Meshopt | frame::Encoding::Delta);
        if is_coded && !range.is_empty() {
            scratch.clear();
            scratch.reserve_exact(range.len());
            let corners = vertices.corners();
            visit(head.attribute(), vertices, &range, PadSteps { corners, out: scratch });
            match held {
                Some(held) if head.encoding() == frame::Encoding::Delta => take_differences(scratch, held),
                Some(held) => held.copy_from_slice(scratch),
                None => {}
            }
            match meshopt::encode_vertex_buffer(scratch) {
                Ok(coded) if !coded.is_empty() => data = PartData::Coded(coded),
                // The encoding is told with every part, so a part that cannot be compressed goes as it is.
                _ => head.set_encoding(frame::Encoding::U16),
            }
        }
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
            PartData::Of(_, range) => range.len() * bytes_a_vertex(self.head.encoding(), self.head.attribute()),
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
            PartData::Of(vertices, range) => {
                let (corners, attribute) = (vertices.corners(), self.head.attribute());
                match self.head.encoding() {
                    frame::Encoding::F32 => visit(attribute, vertices, range, PutFloats(out)),
                    frame::Encoding::U16 => visit(attribute, vertices, range, PutSteps { corners, out }),
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
            PartData::Of(..) => {
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

fn visit(attribute: frame::Attribute, vertices: &FrameVertices, range: &Range<usize>, visitor: impl VertexVisitor) {
    match (attribute, &vertices.shading) {
        (frame::Attribute::Normal, Some(s)) => visitor.take(vertices.pick(&s.normals, range), true),
        (frame::Attribute::Tangent, Some(s)) => visitor.take(vertices.pick(&s.tangents, range), true),
        _ => visitor.take(vertices.pick(&vertices.positions, range), false),
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
