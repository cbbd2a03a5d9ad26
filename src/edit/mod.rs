//! Topology operations: from a surface and what is asked for to the smallest patch that does it.
//!
//! An operation never touches the session's arrays. It reads a [`Surface`] and answers a [`Patch`]: which triangles go,
//! which vertices and triangles come, what the new vertices are made of. [`apply`] turns surface and patch into the next
//! surface with the maps between both, so that attributes, handles, graph and hierarchy can follow. What is far from the
//! edit keeps its order and its bits. Knows no format, no handle and no solver.
//!
//! Topology is that of *points* (welded vertices): a seam in texture coordinates is no gap. A cut that keeps both sides
//! leaves two points at one place, so points are told apart by number, never by position.

mod apply;
mod cap;
mod check;
mod curve;
mod decimate;
mod draft;
mod editable;
mod fair;
mod fans;
mod fill;
mod finish;
mod flips;
mod hole;
mod lid;
mod local;
mod patch;
mod path;
mod places;
mod plane;
mod polygon;
mod refine;
mod remesh;
mod resolved;
mod rims;
mod stitch;
mod subdivide;
mod trace;
mod weld;

pub use apply::{Applied, apply};
pub use check::{Topology, check};
pub use curve::{Curve, MOST_POINTS, insert_curve};
pub use decimate::decimate;
pub use fill::{delete, fill};
pub use local::{Local, Side};
pub use patch::{NewTriangle, NewVertex, Patch, Surface};
pub use path::cut_path;
pub use plane::{Keep, Plane, cut_plane};
pub use remesh::{ASPECT, MENDED, MOST_TRIANGLES, STRETCH, Target, remesh};
pub use stitch::{Between, stitch};
pub use subdivide::{Scheme, subdivide};
pub use weld::{weld, weld_boundaries};

/// Why an edit cannot be done. The surface is as it was.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A value that the operation does not allow.
    #[error("{field}: {problem}")]
    Invalid {
        /// The field as in the request, for example `cut.plane.normal`.
        field: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// The values are allowed, but not on this surface: the plane misses, loops do not match.
    #[error("{problem} ({place})")]
    Impossible {
        /// What stands against it, and a hint.
        problem: String,
        /// Where: points, faces or coordinates.
        place: String,
    },
    /// The result would exceed a limit.
    #[error("the result would have {seen} {what}, the limit is {limit}")]
    TooLarge {
        /// Of what.
        what: &'static str,
        /// How many.
        seen: u64,
        /// How many are allowed.
        limit: u64,
    },
    /// The caller gave up.
    #[error("cancelled")]
    Cancelled,
}
