//! Folds: faces that a pose turned over, or stretched beyond measure, though nothing forces them to.
//!
//! The two passes weigh all edges alike and know no faces, so where a mesh is coarse, noisy or thin against what happens to it a
//! few faces may turn over. They are looked for when a shape is done, and what is around each is brought to agree with the
//! gradients a few rings around: the edges of the patch ask for what the mean gradient there makes of them, and its rim stays.
//! That is eq. (8) once more, on a patch of the surface alone. A patch that does not come out better is left as it was,
//! and a shape without folds keeps every bit.

mod patch;
mod unfold;

pub use patch::FaceSurroundings;
pub use unfold::{FaceChanges, unfold_faces};
