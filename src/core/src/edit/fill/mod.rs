//! Deleting faces and filling holes, and what cuts use of it to close what they open.

mod delaunay;
mod fair;
mod holes;
mod loop_fill;
mod opening;
mod planar;
mod polygon;
mod refine;

pub use holes::{delete_faces, fill_holes};
pub(super) use loop_fill::triangulate_loop;
pub(super) use opening::{OpeningRim, split_double_edges};
pub(super) use planar::{double_area, loop_contains};
pub(super) use polygon::triangulate_polygon;
pub(super) use refine::{RefineSize, WHOLE_EDGES, refine_faces};
