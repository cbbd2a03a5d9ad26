//! Vertex buffers as frames: attributes, encodings, changed vertices and parts.
//!
//! Owns how positions, normals, tangents and gradients become the bytes of [`pb::Frame`] messages. A frame's parts are made one at a
//! time, when they are asked for, so that a slow reader costs no memory; where a part goes out as it is made, its numbers are
//! written straight into the bytes that are sent ([`OutgoingResponse`]). Knows no stream and no session: who may get
//! a frame, and when, is not decided here.

mod numbers;
mod output;
mod part;
mod reader;
mod sent_steps;

pub use output::{FrameEncoding, FrameOutput};
pub use part::OutgoingResponse;
pub use part::{FrameParts, encode, encode_next};
pub use reader::FrameReader;
pub use sent_steps::SentSteps;

use self::numbers::{PickedVertices, put_floats};
use super::pb;
use bytes::Bytes;
use glam::DVec3;
use pliant_core::engine::{Shading, TopologyId};
use pliant_core::mesh::carry::LocalGradients;
use pliant_motion::rig::RigidMotion;
use std::borrow::Cow;
use std::sync::Arc;

/// Positions relative to `origin` as little-endian 32-bit floats, x, y, z per vertex.
pub fn f32_bytes(positions: &[DVec3], origin: DVec3) -> Bytes {
    let mut data = Vec::with_capacity(positions.len() * 12);
    put_floats(PickedVertices::Run(&relative_to(origin, positions)), &mut data);
    data.into()
}

/// Positions as frames hold them.
fn relative_to(origin: DVec3, positions: &[DVec3]) -> Cow<'_, [DVec3]> {
    match origin == DVec3::ZERO {
        true => positions.into(),
        false => positions.iter().map(|p| *p - origin).collect(),
    }
}

/// A frame: its header, the shape that it shows, and how that is encoded.
#[derive(Debug, Clone, Default)]
pub struct Frame {
    /// What all its parts repeat: everything but the numbers.
    pub header: pb::Frame,
    /// The state of the model that its vertices belong to. No frame is a difference from one of another state.
    pub topology: Option<TopologyId>,
    /// Length of the model's diagonal; [`changed_only`](FrameOutput::changed_only) is a fraction of it.
    pub diagonal: f64,
    /// Where the root bone of an animation has moved the model, when that is not in the positions.
    pub root: Option<RigidMotion>,
    /// One per render vertex.
    pub positions: Arc<Vec<DVec3>>,
    /// What they are relative to as they are sent ([`pb::Session::origin`]).
    pub origin: DVec3,
    /// Needed when `output` asks for normals or tangents; without it they are left out.
    pub shading: Option<Arc<Shading>>,
    /// Needed when `output` asks for gradients; without it they are left out.
    pub gradients: Option<Arc<LocalGradients>>,
    /// What to send and how.
    pub output: FrameOutput,
    /// The vertices to send, ascending; `None` is all of them.
    pub selected: Option<Vec<u32>>,
    /// Bytes that the data (and indices) of a part may take.
    pub part_bytes: usize,
}

/// The attributes of frames.
const ATTRIBUTES: [pb::frame::Attribute; 6] = [
    pb::frame::Attribute::Position,
    pb::frame::Attribute::Normal,
    pb::frame::Attribute::Tangent,
    pb::frame::Attribute::Rotation,
    pb::frame::Attribute::Stretch,
    pb::frame::Attribute::Shear,
];

/// Stretches and shears that are sent as steps lie between this and its negative.
const MOST_STRETCH: f64 = 4.0;

/// Numbers of a vertex.
const fn width_of(attribute: pb::frame::Attribute) -> usize {
    match attribute {
        pb::frame::Attribute::Tangent | pb::frame::Attribute::Rotation => 4,
        _ => 3,
    }
}

/// What the last step of an attribute stands for, and its negative the first; of positions that is the box of a frame.
fn range_of(attribute: pb::frame::Attribute) -> Option<f64> {
    match attribute {
        pb::frame::Attribute::Position => None,
        pb::frame::Attribute::Normal | pb::frame::Attribute::Tangent | pb::frame::Attribute::Rotation => Some(1.0),
        pb::frame::Attribute::Stretch | pb::frame::Attribute::Shear => Some(MOST_STRETCH),
    }
}

/// Bytes of the steps of a vertex, of one attribute.
const KEPT_BYTES: usize = size_of::<[u16; 4]>();

/// Vertices from which on compressing a frame would block a connection's thread too long.
const MANY_TO_COMPRESS: usize = 4096;

impl Frame {
    /// The frame for a reader that holds nothing: a frame of changes carries all vertices.
    #[must_use]
    pub fn for_new_reader(mut self) -> Self {
        let is_listed = self.output.changed_only.is_some();
        self.selected = is_listed.then(|| (0..self.positions.len()).map(|v| v as u32).collect());
        self
    }

    /// How many vertices are sent.
    fn count(&self) -> usize {
        self.selected.as_ref().map_or(self.positions.len(), Vec::len)
    }

    /// Whether making its parts holds up a thread for long.
    pub fn is_slow_to_encode(&self) -> bool {
        let is_coded = matches!(self.output.encoding, FrameEncoding::Meshopt | FrameEncoding::Delta);
        is_coded && self.count() > MANY_TO_COMPRESS
    }

    /// Bytes that its stream holds in addition, for the differences of the next frame.
    pub fn kept_bytes(&self) -> u64 {
        if !self.has_differences() {
            return 0;
        }
        let attributes = self.carries().into_iter().filter(|&is_carried| is_carried).count();
        (self.positions.len() * attributes * KEPT_BYTES) as u64
    }

    /// Which of [`ATTRIBUTES`] it carries.
    fn carries(&self) -> [bool; ATTRIBUTES.len()] {
        let count = self.positions.len();
        let fits = |s: &Arc<Shading>| s.normals.len() == count && s.tangents.len() == count;
        // One empty part stands for an empty change.
        let is_empty = count == 0 || self.selected.as_ref().is_some_and(Vec::is_empty);
        let shades = self.shading.as_ref().is_some_and(fits) && !is_empty;
        let whole = |g: &Arc<LocalGradients>| [g.rotations.len(), g.stretches.len(), g.shears.len()] == [count; 3];
        let turns = self.output.gradients && !is_empty && self.gradients.as_ref().is_some_and(whole);
        let (normals, tangents) = (shades && self.output.normals, shades && self.output.tangents);
        [true, normals, tangents, turns, turns, turns]
    }

    fn has_differences(&self) -> bool {
        // `DeformOptions` rejects differences of some of the vertices.
        self.output.encoding == FrameEncoding::Delta && self.selected.is_none()
    }

    /// Bytes held, about.
    pub fn byte_size(&self) -> u64 {
        let shading = (self.shading.as_ref()).map_or(0, |s| s.normals.len() * 12 + s.tangents.len() * 16);
        let selected = self.selected.as_ref().map_or(0, |s| size_of_val(s.as_slice()));
        let gradients = self.gradients.as_ref().map_or(0, |gradients| gradients.byte_size());
        (size_of_val(self.positions.as_slice()) + shading + gradients + selected) as u64
    }
}

#[cfg(test)]
mod difference_tests;
#[cfg(test)]
mod tests;
