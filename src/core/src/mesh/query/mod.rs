//! Geometry queries that several rooms ask: each concept has one file here, and everybody calls it.
//!
//! [`closest_point`](mod@closest_point) answers for one triangle or one segment, [`fan`] groups the faces around a vertex, and
//! [`TriangleBvh`] is the bounding-volume hierarchy for questions about many triangles: the closest point
//! ([`SurfacePoint`]), the first crossing of a segment ([`SegmentHit`]) and the triangles that overlap a box. Questions of short
//! reach about triangles of about one size are faster asked of [`TriangleCells`].

pub(crate) mod box_grid;
pub mod bvh;
pub mod closest_point;
mod closest_surface_point;
pub mod fan;
mod nearest_points;
mod segment_hit;
mod triangle_cells;
mod visits;

pub use bvh::TriangleBvh;
pub(crate) use closest_surface_point::NearVisitor;
pub use closest_surface_point::SurfacePoint;
pub(crate) use closest_surface_point::corner_near;
pub use nearest_points::NearestPoints;
pub use segment_hit::SegmentHit;
pub use triangle_cells::TriangleCells;
pub(crate) use visits::{QueryStop, VisitBudget, VisitCount};
