//! What an edit answers: the smallest patch that does it, and how a patch becomes the next surface.

mod apply;
mod resolve;
mod surface_patch;

pub use apply::apply_patch;
pub use surface_patch::{EditWarning, NewTriangle, NewVertex, PatchedSurface, SurfacePatch};
