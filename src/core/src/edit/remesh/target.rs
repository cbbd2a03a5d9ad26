//! What a remesh aims for.

use glam::DVec3;

/// What a remesh aims for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RemeshTarget<'a> {
    /// Edges of this length everywhere.
    Length(f64),
    /// Only around faces with an edge longer than [`STRETCH`] times its rest length, or an aspect over [`ASPECT`]; there
    /// edges get their rest length.
    Auto {
        /// The rest shape: one position per render vertex.
        rest: &'a [DVec3],
    },
}

/// How a remesh goes about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RemeshOptions<'a> {
    /// What it aims for.
    pub target: RemeshTarget<'a>,
    /// How far the old and the new surface may be from each other, model units. `None`: [`DEVIATION`] of the diagonal of
    /// the surface's bounding box, or [`LENGTH_DEVIATION`] of the length that is aimed for where that is more.
    pub max_deviation: Option<f64>,
    /// An edge stays an edge when the normals of its faces differ by more, degrees.
    pub sharp_degrees: f64,
}

impl<'a> From<RemeshTarget<'a>> for RemeshOptions<'a> {
    fn from(target: RemeshTarget<'a>) -> Self {
        Self {
            target,
            max_deviation: None,
            sharp_degrees: SHARP_DEGREES,
        }
    }
}

/// The part of the diagonal by which surfaces may differ where nothing else is asked for.
pub const DEVIATION: f64 = 1.5e-3;

/// The part of the length aimed for by which surfaces may differ where nothing else is asked for.
pub const LENGTH_DEVIATION: f64 = 0.2;

/// Edges sharper than this stay edges where nothing else is asked for, degrees.
pub const SHARP_DEGREES: f64 = 40.0;

/// [`RemeshTarget::Auto`] remeshes where an edge is longer than this times its rest length.
pub const STRETCH: f64 = 1.5;

/// [`RemeshTarget::Auto`] remeshes where a face is further from equilateral than this: longest side times perimeter over
/// 4·√3 times the area, 1 at best.
pub const ASPECT: f64 = 4.0;

/// Faces are mended until none is worse than this, as far as boundaries and lines allow.
pub const MENDED: f64 = 4.0;

/// Most triangles that a remesh makes.
pub const MOST_TRIANGLES: u64 = 8 << 20;
