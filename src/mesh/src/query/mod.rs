//! Geometry queries that several modules ask: each concept has one file here.
//!
//! [`closest_point`](mod@closest_point) answers for one triangle or one segment, [`closest_surface_point`] groups the faces around a vertex, and
//! [`TriangleBvh`] is the bounding-volume hierarchy for questions about many triangles: the closest point
//! ([`SurfacePoint`]), the first crossing of a segment ([`SegmentHit`]) and the triangles that overlap a box. Questions of short
//! reach about triangles of about one size are faster asked of [`TriangleCells`].

pub mod bvh;
pub mod closest_point;
pub mod closest_surface_point;
pub(crate) mod triangle_cells;
mod visits;

pub use bvh::TriangleBvh;
pub use closest_point::NearestPoints;
pub use closest_surface_point::{NearVisitor, SegmentHit, SurfacePoint, corner_near};
pub use triangle_cells::TriangleCells;
pub use visits::{QueryStop, VisitBudget, VisitCount};
