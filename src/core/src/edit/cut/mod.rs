//! Cutting a surface: by a plane or along a curve on it, with caps over what a cut opens.

mod along_curve;
mod curve;
mod flat_cap;
mod matching_cap;
mod nearest_face;
mod options;
mod plane;
mod plane_sides;
mod trace;

pub use along_curve::cut_along_curve;
pub use curve::{MOST_POINTS, SurfaceCurve, insert_curve};
pub use options::{CutOptions, KeptSide};
pub use plane::cut_by_plane;
pub use plane_sides::CutPlane;
