//! Where a point lies relative to triangles: winding number, nearest point, first crossing.
//!
//! All three run on one tree over the triangles. The generalised winding number (Jacobson et al. 2013) says how often a
//! surface wraps around a point, a whole number where it is closed and a sensible fraction where it has holes; the tree
//! evaluates distant clusters by their moments (Barill et al. 2018).

mod moments;
mod nearest;
mod number;
mod tree;

pub(super) use nearest::closest_on_triangle;
pub use nearest::{Hit, Nearest};
pub use tree::WindingTree;
