//! Triangles as the solver sees them: welded vertices, clean faces, what is next to what, and what is wrong with them.
//!
//! Owns the map between render vertices (a model's, split along shading seams) and solver vertices (points in space),
//! adjacency, connected components, measures and the inspection report. Takes plain slices: it knows no file format,
//! no graph interior and no solver.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod adjacency;
pub mod carry;
mod crossing_pairs;
mod error;
pub mod graph;
mod inspect;
mod intersections;
pub mod local_turns;
mod measure;
mod moving_crossings;
pub mod query;
pub mod rotation;
pub mod shading;
#[cfg(test)]
mod testing;
mod weld;
mod welded_mesh;

pub use adjacency::{Adjacency, BoundaryLoop, Components, Lists, MeshEdge, boundary_loops, sorted_set};
pub use crossing_pairs::{CrossingPair, CrossingPairs, PairKind};
pub use error::{Error, shown_count};
pub use inspect::{MeshReport, MeshWarning, PartReport, inspect};
pub use intersections::{
    Crossing, CrossingCount, count_crossings, crossing_triangles, is_crossing, self_intersections, visit_crossings,
    visit_crossings_within,
};
pub use measure::{
    BoundingBox, brief_number, brief_point, grouped_count, mean_edge_length, signed_volume, surface_area,
};
pub use moving_crossings::MovingCrossings;
pub use weld::{Weld, mix_bits};
pub use welded_mesh::{Mesh, NONE};
