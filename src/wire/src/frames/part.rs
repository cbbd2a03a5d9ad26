//! One part of a frame, from its vertices to the bytes that are sent: its numbers are written once.

use super::numbers::{
    PickedVertices, Steps, VertexNumbers, push_padded_steps, put_floats, put_steps, take_differences,
};
use super::pb::deform_response::Message as Response;
use super::pb::frame;
use super::sent_steps::{FrameKind, FrameReference, SentSteps};
use super::{ATTRIBUTES, Frame, pb, range_of, relative_to, width_of};
use crate::facts::origin_numbers;
use bytes::{Buf, BufMut};
use glam::DVec3;
use prost::encoding::{DecodeContext, WireType, encode_key, encode_varint, encoded_len_varint, key_len};
use prost::{DecodeError, Message};
use std::borrow::Cow;
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

/// `DeformResponse.frame`.
const FRAME: u32 = 1;
/// `Frame.data`. It is written last: a message's fields may come in any order.
const DATA: u32 = 7;

/// A response of a deform stream as it goes out, in place of [`pb::DeformResponse`]: the bytes of both say the same. The
/// numbers of a frame stay where they are until they are written, once, into the bytes that are sent.
#[derive(Debug, Default)]
pub struct OutgoingResponse {
    /// The response; a frame in it has no numbers.
    message: pb::DeformResponse,
    /// The numbers of that frame.
    data: PartData,
}

#[derive(Debug)]
enum PartData {
    /// To be written from these vertices.
    Of(VertexRun),
    /// Encoded already, since the length is not known before. Responses that are no frame have none.
    Coded(Vec<u8>),
}

impl Default for PartData {
    fn default() -> Self {
        Self::Coded(Vec::new())
    }
}

impl From<Response> for OutgoingResponse {
    fn from(message: Response) -> Self {
        Self {
            message: pb::DeformResponse { message: Some(message) },
            data: PartData::default(),
        }
    }
}

impl OutgoingResponse {
    /// The part of a frame with the vertices of `run` and the header `head`. Meshopt data is encoded here, by way of `scratch`;
    /// on a stream with differences, `held` is what its reader has of these vertices.
    pub(super) fn of_part(
        mut head: pb::Frame,
        run: VertexRun,
        scratch: &mut Vec<[u16; 4]>,
        held: Option<&mut [[u16; 4]]>,
    ) -> Self {
        let mut coded = Vec::new();
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
            coded = meshopt::encode_vertex_buffer(scratch).unwrap_or_default();
            if coded.is_empty() {
                // Every part names its encoding, so a part that cannot be compressed is sent uncompressed.
                head.set_encoding(frame::Encoding::U16);
            }
        }
        Self {
            message: pb::DeformResponse {
                message: Some(Response::Frame(head)),
            },
            data: match coded.is_empty() {
                true => PartData::Of(run),
                false => PartData::Coded(coded),
            },
        }
    }

    /// What is sent, but for the numbers of a frame.
    pub fn message(&self) -> Option<&Response> {
        self.message.message.as_ref()
    }

    /// The frame, with its numbers; `None` for another response.
    pub fn into_frame(self) -> Option<pb::Frame> {
        match pb::DeformResponse::from(self).message {
            Some(Response::Frame(frame)) => Some(frame),
            _ => None,
        }
    }

    /// The header of a frame.
    fn head(&self) -> Option<&pb::Frame> {
        match self.message() {
            Some(Response::Frame(head)) => Some(head),
            _ => None,
        }
    }

    /// Bytes of numbers.
    pub fn data_bytes(&self) -> usize {
        match (&self.data, self.head()) {
            (PartData::Of(run), Some(head)) => run.range.len() * bytes_a_vertex(head.encoding(), head.attribute()),
            (PartData::Coded(coded), _) => coded.len(),
            (PartData::Of(_), None) => 0,
        }
    }

    /// Writes the numbers of the frame `head`.
    fn write_data(&self, head: &pb::Frame, out: &mut impl BufMut) {
        match &self.data {
            PartData::Coded(coded) => out.put_slice(coded),
            PartData::Of(run) => {
                let (corners, attribute) = (run.corners, head.attribute());
                match head.encoding() {
                    frame::Encoding::F32 => visit(attribute, run, PutFloats(out)),
                    frame::Encoding::U16 => visit(attribute, run, PutSteps { corners, out }),
                    // Coded, unless it is empty.
                    frame::Encoding::Meshopt | frame::Encoding::Delta => {}
                }
            }
        }
    }
}

impl From<OutgoingResponse> for pb::DeformResponse {
    fn from(response: OutgoingResponse) -> Self {
        let mut data = Vec::new();
        if let (Some(head), PartData::Of(_)) = (response.head(), &response.data) {
            data.reserve_exact(response.data_bytes());
            response.write_data(head, &mut data);
        }
        let OutgoingResponse {
            mut message,
            data: coded,
        } = response;
        if let Some(Response::Frame(frame)) = &mut message.message {
            frame.data = match coded {
                PartData::Coded(coded) => coded.into(),
                PartData::Of(_) => data.into(),
            };
        }
        message
    }
}

/// Bytes of a field that holds `bytes` bytes.
fn delimited_bytes(tag: u32, bytes: usize) -> usize {
    key_len(tag) + encoded_len_varint(bytes as u64) + bytes
}

fn open_field(tag: u32, bytes: usize, out: &mut impl BufMut) {
    encode_key(tag, WireType::LengthDelimited, out);
    encode_varint(bytes as u64, out);
}

/// Bytes of a frame's message with `data` bytes of numbers.
fn frame_bytes(head: &pb::Frame, data: usize) -> usize {
    head.encoded_len() + if data > 0 { delimited_bytes(DATA, data) } else { 0 }
}

impl Message for OutgoingResponse {
    fn encode_raw(&self, out: &mut impl BufMut) {
        let Some(head) = self.head() else {
            return self.message.encode_raw(out);
        };
        let data = self.data_bytes();
        open_field(FRAME, frame_bytes(head, data), out);
        head.encode_raw(out);
        if data > 0 {
            open_field(DATA, data, out);
            self.write_data(head, out);
        }
    }

    fn encoded_len(&self) -> usize {
        match self.head() {
            Some(head) => delimited_bytes(FRAME, frame_bytes(head, self.data_bytes())),
            None => self.message.encoded_len(),
        }
    }

    fn merge_field(
        &mut self,
        tag: u32,
        wire_type: WireType,
        bytes: &mut impl Buf,
        context: DecodeContext,
    ) -> Result<(), DecodeError> {
        let mut message = pb::DeformResponse::from(std::mem::take(self));
        let merged = message.merge_field(tag, wire_type, bytes, context);
        // The numbers of a frame that was read go out by themselves again.
        let data = match &mut message.message {
            Some(Response::Frame(frame)) => std::mem::take(&mut frame.data).into(),
            _ => Vec::new(),
        };
        *self = Self {
            message,
            data: PartData::Coded(data),
        };
        merged
    }

    fn clear(&mut self) {
        *self = Self::default();
    }
}

/// Bytes that a vertex takes, at most.
pub(super) fn bytes_a_vertex(encoding: frame::Encoding, attribute: frame::Attribute) -> usize {
    let numbers = width_of(attribute);
    match encoding {
        frame::Encoding::F32 => numbers * 4,
        frame::Encoding::U16 => numbers * 2,
        // Four numbers of two bytes; what cannot be compressed grows by less than an eighth.
        frame::Encoding::Meshopt | frame::Encoding::Delta => 9,
    }
}

/// What is done with vertices of whatever kind.
trait VertexVisitor {
    /// Takes them; `range` is how large their numbers are at most, where that does not depend on the frame.
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, range: Option<f64>);
}

fn visit(attribute: frame::Attribute, run: &VertexRun, visitor: impl VertexVisitor) {
    let range = range_of(attribute);
    match (attribute, &run.frame.shading, &run.frame.gradients) {
        (frame::Attribute::Normal, Some(s), _) => visitor.take(run.pick(&s.normals), range),
        (frame::Attribute::Tangent, Some(s), _) => visitor.take(run.pick(&s.tangents), range),
        (frame::Attribute::Rotation, _, Some(g)) => visitor.take(run.pick(&g.rotations), range),
        (frame::Attribute::Stretch, _, Some(g)) => visitor.take(run.pick(&g.stretches), range),
        (frame::Attribute::Shear, _, Some(g)) => visitor.take(run.pick(&g.shears), range),
        _ => visitor.take(run.pick(&run.frame.positions), None),
    }
}

struct PutFloats<'a, B>(&'a mut B);

impl<B: BufMut> VertexVisitor for PutFloats<'_, B> {
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, _: Option<f64>) {
        put_floats(vertices, self.0);
    }
}

struct PutSteps<'a, B> {
    corners: [DVec3; 2],
    out: &'a mut B,
}

impl<B: BufMut> VertexVisitor for PutSteps<'_, B> {
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, range: Option<f64>) {
        put_steps(vertices, &steps_of(self.corners, range), self.out);
    }
}

struct PadSteps<'a> {
    corners: [DVec3; 2],
    out: &'a mut Vec<[u16; 4]>,
}

impl VertexVisitor for PadSteps<'_> {
    fn take<const N: usize, V: VertexNumbers<N>>(self, vertices: PickedVertices<'_, V>, range: Option<f64>) {
        push_padded_steps(vertices, &steps_of(self.corners, range), self.out);
    }
}

fn steps_of<const N: usize>([low, high]: [DVec3; 2], range: Option<f64>) -> Steps<N> {
    if let Some(range) = range {
        return Steps::between([-range; N], [range; N]);
    }
    let of = |corner: DVec3| std::array::from_fn(|k| corner.to_array().get(k).copied().unwrap_or(0.0));
    Steps::between(of(low), of(high))
}

/// Prepares a frame that stands for itself; the iterator makes its parts one by one. With differences it is a key
/// frame.
///
/// There is always at least one part. Attributes follow one another in the order of their numbers.
pub fn encode(request: Frame) -> FrameParts {
    prepare(request, None)
}

/// Prepares the next frame of a stream. The reader holds `sent`, and [`FrameParts::into_sent`] when all its parts are
/// sent.
pub fn encode_next(request: Frame, sent: SentSteps) -> FrameParts {
    prepare(request, Some(sent))
}

fn prepare(mut request: Frame, sent: Option<SentSteps>) -> FrameParts {
    if let Cow::Owned(relative) = relative_to(request.origin, &request.positions) {
        request.positions = Arc::new(relative);
    }
    let kind = FrameKind {
        output: request.output,
        origin: request.origin,
        topology: request.topology,
        carries: request.carries(),
        vertices: request.count(),
    };
    let reference = if request.has_differences() {
        FrameReference::of_difference(kind, sent, &request)
    } else {
        FrameReference::of_itself(sent, &request)
    };
    let is_listed = request.selected.is_some();
    let (blocks, parts) = blocks(&kind, reference.encoding, is_listed, request.part_bytes);
    FrameParts {
        header: pb::Frame {
            number: reference.number,
            origin: origin_numbers(request.origin),
            ..request.header.clone()
        },
        frame: Arc::new(request),
        blocks,
        reference,
        scratch: Vec::new(),
        next: 0,
        parts,
    }
}

/// The runs of parts of a frame, and how many parts they are.
fn blocks(
    kind: &FrameKind,
    encoding: frame::Encoding,
    is_listed: bool,
    part_bytes: usize,
) -> ([FrameBlock; ATTRIBUTES.len()], u32) {
    let index_bytes = if is_listed { 4 } else { 0 };
    let mut parts = 0u32;
    let blocks = std::array::from_fn(|k| {
        let (attribute, is_sent) = (ATTRIBUTES[k], kind.carries[k]);
        let run = (part_bytes / (bytes_a_vertex(encoding, attribute) + index_bytes)).max(1);
        let first_part = parts;
        if is_sent {
            let count = u32::try_from(kind.vertices.div_ceil(run).max(1)).unwrap_or(u32::MAX);
            parts = parts.saturating_add(count);
        }
        FrameBlock {
            attribute,
            first_part,
            end_part: parts,
            run,
        }
    });
    (blocks, parts)
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
    frame: Arc<Frame>,
    blocks: [FrameBlock; ATTRIBUTES.len()],
    /// What the numbers refer to.
    reference: FrameReference,
    /// The input of meshopt.
    scratch: Vec<[u16; 4]>,
    next: u32,
    parts: u32,
}

impl FrameParts {
    /// Whether there is another part.
    pub fn has_more(&self) -> bool {
        self.next < self.parts
    }

    /// What the reader holds after all parts. Before that it is not a base for another frame.
    pub fn into_sent(self) -> SentSteps {
        self.reference.into_sent()
    }

    /// The next part, to send its bytes; as an iterator this gives messages.
    pub fn next_part(&mut self) -> Option<OutgoingResponse> {
        let part = self.next;
        let block = self
            .blocks
            .iter()
            .find(|b| (b.first_part..b.end_part).contains(&part))?;
        let first = (part - block.first_part) as usize * block.run;
        let end = first.saturating_add(block.run).min(self.frame.count());
        let indices = self.frame.selected.as_ref().map(|s| s[first..end].to_vec());
        let bounds = self.reference.bounds;
        let corners = bounds.map(|bounds| match range_of(block.attribute) {
            None => bounds,
            Some(range) => [DVec3::splat(-range), DVec3::splat(range)],
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
            encoding: self.reference.encoding.into(),
            attribute: block.attribute.into(),
            box_min: corner(0),
            box_max: corner(1),
            ..self.header.clone()
        };
        self.next += 1;
        let held = self
            .reference
            .held(block.attribute)
            .and_then(|held| held.get_mut(first..end));
        Some(OutgoingResponse::of_part(
            head,
            VertexRun {
                frame: Arc::clone(&self.frame),
                range: first..end,
                corners: bounds.unwrap_or([DVec3::NEG_ONE, DVec3::ONE]),
            },
            &mut self.scratch,
            held,
        ))
    }
}

impl Iterator for FrameParts {
    type Item = pb::Frame;

    fn next(&mut self) -> Option<pb::Frame> {
        self.next_part()?.into_frame()
    }
}
