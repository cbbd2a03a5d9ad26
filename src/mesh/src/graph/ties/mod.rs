//! Ties: edges that hold parts of a mesh together where they touch, overlap or nearly touch.
//!
//! Every vertex of a part looks for the nearest places of other parts within reach, and is joined to the corners of the
//! triangles they lie on, the firmer the nearer. Such edges are like any other: rotations and scales flow across them in
//! the first pass, and the second keeps what they join at its offset. A graph with ties remembers them
//! ([`PartTies`]), so that it can be had without them and so that an edit finds again only those around itself.

mod insert;
pub(super) mod part_ties;
mod part_tree;

pub use insert::{resample_tied, tie_parts};
pub use part_ties::{LOOSE, PartTies, TieAnchor, TieFamilies, TieOptions};
