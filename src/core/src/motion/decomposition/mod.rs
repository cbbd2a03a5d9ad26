//! Skinning decomposition: a few rigid bones and at most four weights a vertex that play a whole animation (smooth skinning
//! decomposition with rigid bones, Le and Deng 2012).
//!
//! A [`ShapeSequence`] takes the frames; [`decompose`] finds bones, their motions and the weights together, and
//! [`fit_weights`] finds weights alone where the bones' motions are given, such as those of a skeleton.
//!
//! The paper alternates between two fits, and so does this. What makes it quick here is that both are quadratic in affine
//! functions of the rest position: the products of all bones over all frames (`bone_products`) and the moments of all pairs
//! of bones over all vertices (`bone_fit`) are formed once, and then neither the weights of a vertex nor a further sweep over
//! the bones of a frame costs anything that grows with the number of frames or vertices. So the sets of four bones are
//! searched, where the paper cuts a fit of all bones down to four, and bones are swept until they stand still. Most of the work
//! is done on a sample of vertices and frames (`decompose`), as a bone's motion is known well from a few hundred vertices.

mod bone_fit;
mod clusters;
mod decompose;
mod sequence;
mod weight_fit;

pub use decompose::{DecompositionOptions, SkinDecomposition, decompose, fit_weights};
pub use sequence::{DecompositionError, ShapeSequence};
