//! What a remesh aims for.

use glam::DVec3;

/// What a remesh aims for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RemeshTarget<'a> {
    /// Edges of this length everywhere.
    Length(f64),
    /// Only around faces with an edge longer than [`STRETCH`] times its rest length, or an aspect over [`ASPECT`]; there
    /// edges as long as they are at rest.
    Auto {
        /// The rest shape: one position per render vertex.
        rest: &'a [DVec3],
    },
}

/// [`RemeshTarget::Auto`] remeshes where an edge is longer than this times its rest length.
pub const STRETCH: f64 = 1.5;

/// [`RemeshTarget::Auto`] remeshes where a face is further from equilateral than this: longest side times perimeter over
/// 4·√3 times the area, 1 at best.
pub const ASPECT: f64 = 4.0;

/// Faces are mended until none is worse than this, as far as boundaries and lines allow.
pub const MENDED: f64 = 4.0;

/// Most triangles that a remesh makes.
pub const MOST_TRIANGLES: u64 = 8 << 20;
