//! What frames carry, and how their numbers are written.

use super::pb::frame;

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
    /// Whether they carry rotation, stretch and shear of the motion around vertices.
    pub gradients: bool,
    /// The number of these options on their stream, from 1; 0 without a stream. No frame is a difference from one of
    /// other options.
    pub asked: u64,
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
    /// The same, as differences from the frame before if possible.
    Delta,
}

impl FrameEncoding {
    pub(crate) fn from_message(encoding: frame::Encoding) -> Self {
        match encoding {
            frame::Encoding::F32 => Self::F32,
            frame::Encoding::U16 => Self::U16,
            frame::Encoding::Meshopt => Self::Meshopt,
            frame::Encoding::Delta => Self::Delta,
        }
    }

    pub(crate) fn to_message(self) -> frame::Encoding {
        match self {
            Self::F32 => frame::Encoding::F32,
            Self::U16 => frame::Encoding::U16,
            Self::Meshopt => frame::Encoding::Meshopt,
            Self::Delta => frame::Encoding::Delta,
        }
    }
}
