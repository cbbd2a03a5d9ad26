//! What the reader of a stream holds, as its sender knows it: the steps of the last sent frame.
//!
//! Differences are formed from it when a frame is sent, so that a frame which was never sent leaves no gap. Steps are
//! whole numbers and differences wrap, so no error adds up: a reader that adds every difference has the exact steps.

use super::output::{FrameEncoding, FrameOutput};
use super::pb::frame;
use super::{ATTRIBUTES, Frame, KEPT_BYTES};
use glam::DVec3;
use pliant_core::engine::TopologyId;

/// The box of a key frame reaches beyond its shape by this part of its largest extent on each side, so that the frames that follow
/// have room to move.
const ROOM: f64 = 0.125;
/// A shape that fills less than this part of the box, by the largest extents of both, gets a box of its own: its steps have become
/// coarse.
const LEAST_FILLED: f64 = 0.25;

/// What the reader of a stream holds after the frames that it was sent. Of streams that ask for no differences it holds nothing.
#[derive(Debug, Default)]
pub struct SentSteps {
    /// How many frames of the stream were begun that differences may refer to.
    number: u64,
    last: Option<LastFrame>,
}

/// The frame that was sent last.
#[derive(Debug)]
struct LastFrame {
    kind: FrameKind,
    /// The box of its key frame.
    corners: [DVec3; 2],
    /// Steps of each attribute, four a vertex; of what it does not carry there are none.
    steps: [Vec<[u16; 4]>; ATTRIBUTES.len()],
}

/// Frames of one kind can be sent as differences.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrameKind {
    /// What was asked for, and by which options.
    pub output: FrameOutput,
    /// What its positions are relative to.
    pub origin: DVec3,
    /// The state of the model that its vertices belong to.
    pub topology: Option<TopologyId>,
    /// Which attributes it carries.
    pub carries: [bool; ATTRIBUTES.len()],
    pub vertices: usize,
}

/// What the numbers of a frame under way refer to.
#[derive(Debug)]
pub(super) struct FrameReference {
    /// The encoding of parts that can be compressed.
    pub encoding: frame::Encoding,
    /// Its number among the stream's frames that differences may refer to; 0 is none.
    pub number: u64,
    /// The box of positions that are sent as steps.
    pub bounds: Option<[DVec3; 2]>,
    /// What the reader holds: of the frame before where the next parts go, of this one where they went.
    reader: SentSteps,
}

impl LastFrame {
    /// With room for the steps of a key frame, where there was room for those of the frame before.
    fn of_key(kind: FrameKind, corners: [DVec3; 2], before: Option<Self>) -> Self {
        let mut steps = before.map(|before| before.steps).unwrap_or_default();
        for (steps, is_carried) in steps.iter_mut().zip(kind.carries) {
            let count = if is_carried { kind.vertices } else { 0 };
            if steps.len() != count {
                // Of the size that is counted, not of that of a model that was larger.
                *steps = vec![[0; 4]; count];
            }
        }
        Self { kind, corners, steps }
    }
}

impl SentSteps {
    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        let held = self.last.as_ref().map_or(0, |last| {
            last.steps.iter().map(|steps| steps.capacity() * KEPT_BYTES).sum()
        });
        held as u64
    }
}

impl FrameReference {
    /// Writes a frame that stands for itself; keeps nothing.
    pub fn of_itself(sent: Option<SentSteps>, request: &Frame) -> Self {
        let encoding = match request.output.encoding {
            FrameEncoding::Delta => frame::Encoding::Meshopt,
            other => other.to_message(),
        };
        let has_steps = encoding != frame::Encoding::F32;
        Self {
            encoding,
            number: 0,
            bounds: has_steps.then(|| bounds(&request.positions, request.selected.as_deref())),
            reader: SentSteps {
                number: sent.map_or(0, |sent| sent.number),
                last: None,
            },
        }
    }

    /// Writes differences, where the reader holds the frame before and the shape stays in the box of its key frame;
    /// else writes a key frame. Without `sent` no frame follows.
    pub fn of_difference(kind: FrameKind, sent: Option<SentSteps>, request: &Frame) -> Self {
        let shape = bounds(&request.positions, None);
        let Some(SentSteps { number, last }) = sent else {
            return Self {
                encoding: frame::Encoding::Meshopt,
                number: 1,
                bounds: Some(roomy(shape)),
                reader: SentSteps::default(),
            };
        };
        let number = number + 1;
        let (encoding, last) = match last {
            Some(last) if last.kind == kind && is_at_home(shape, last.corners) => (frame::Encoding::Delta, last),
            last => (frame::Encoding::Meshopt, LastFrame::of_key(kind, roomy(shape), last)),
        };
        Self {
            encoding,
            number,
            bounds: Some(last.corners),
            reader: SentSteps {
                number,
                last: Some(last),
            },
        }
    }

    /// The steps that the reader holds of an attribute, to be replaced by those of a part.
    pub fn held(&mut self, attribute: frame::Attribute) -> Option<&mut [[u16; 4]]> {
        let last = self.reader.last.as_mut()?;
        Some(last.steps.get_mut(attribute as usize)?.as_mut_slice())
    }

    /// What the reader holds when all parts are sent.
    pub fn into_sent(self) -> SentSteps {
        self.reader
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

/// The box of a shape, with room.
fn roomy([low, high]: [DVec3; 2]) -> [DVec3; 2] {
    let room = DVec3::splat(ROOM * (high - low).max_element());
    let wide = [low - room, high + room];
    // Numbers near the end of what there is leave no room.
    if (wide[1] - wide[0]).is_finite() {
        wide
    } else {
        [low, high]
    }
}

/// Whether a shape lies in a box and fills enough of it.
fn is_at_home([low, high]: [DVec3; 2], [from, to]: [DVec3; 2]) -> bool {
    let fills = (high - low).max_element() >= LEAST_FILLED * (to - from).max_element();
    low.cmpge(from).all() && high.cmple(to).all() && fills
}
