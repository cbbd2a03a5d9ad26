//! Deleting faces and filling holes, and what cuts use of it to close what they open.

mod holes;
mod loop_fill;
mod opening;
mod polygon;

pub use holes::{delete_faces, fill_holes};
pub(super) use loop_fill::triangulate_loop;
pub(super) use loop_fill::{RefineSize, WHOLE_EDGES, refine_faces};
pub(super) use opening::{OpeningRim, split_double_edges};
pub(super) use polygon::triangulate_polygon;
pub(super) use polygon::{double_area, loop_contains};
