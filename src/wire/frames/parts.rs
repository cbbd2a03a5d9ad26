//! The parts of a frame, in order.

use super::Frame;
use super::part::{OutgoingResponse, VertexRun, bytes_a_vertex};
use super::pb::{self, frame};
use super::sent_steps::{FrameKind, FrameReference, SentSteps};
use glam::DVec3;
use std::sync::Arc;

/// Prepares a frame that stands for itself; the iterator makes its parts one by one. With differences it is a key
/// frame.
///
/// There is always at least one part. Attributes follow one another: positions, then normals, then tangents.
pub fn encode(request: Frame) -> FrameParts {
    prepare(request, None)
}

/// Prepares the next frame of a stream. The reader holds `sent`, and [`FrameParts::into_sent`] when all its parts are
/// sent.
pub fn encode_next(request: Frame, sent: SentSteps) -> FrameParts {
    prepare(request, Some(sent))
}

fn prepare(request: Frame, sent: Option<SentSteps>) -> FrameParts {
    let kind = FrameKind {
        output: request.output,
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
fn blocks(kind: &FrameKind, encoding: frame::Encoding, is_listed: bool, part_bytes: usize) -> ([FrameBlock; 3], u32) {
    let attributes = [
        (frame::Attribute::Position, kind.carries[0]),
        (frame::Attribute::Normal, kind.carries[1]),
        (frame::Attribute::Tangent, kind.carries[2]),
    ];
    let index_bytes = if is_listed { 4 } else { 0 };
    let mut parts = 0u32;
    let blocks = attributes.map(|(attribute, is_sent)| {
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
    blocks: [FrameBlock; 3],
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
        let corners = bounds.map(|bounds| match block.attribute {
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
