//! Cutting a surface: by a plane or along a curve on it, with caps over what a cut opens.

mod curve;
mod flat_cap;
mod plane;
mod trace;

pub use curve::cut_along_curve;
pub use curve::{MOST_POINTS, SurfaceCurve, insert_curve};
pub use plane::CutPlane;
pub use plane::cut_by_plane;
pub use plane::{CutOptions, KeptSide};
