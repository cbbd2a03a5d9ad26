//! What an edit answers: the smallest patch that does it, and how a patch becomes the next surface.

mod apply;
mod resolve;

pub use apply::PatchedSurface;
pub use apply::apply_patch;
pub use apply::{EditWarning, NewTriangle, NewVertex, SurfacePatch};
