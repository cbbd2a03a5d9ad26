//! How often triangles wrap around a point.
//!
//! The generalised winding number (Jacobson et al. 2013) says how often a surface wraps around a point, a whole number where
//! it is closed and a sensible fraction where it has holes; the tree evaluates distant clusters by their moments (Barill et
//! al. 2018).

mod number;
pub(super) mod tree;

pub use tree::WindingTree;
