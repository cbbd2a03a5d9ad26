//! Carries points of rest space along with a deformed surface: what is not a part of a model's solve follows it.
//!
//! A point on the surface goes where its place on the surface goes. A point beside it, inside or outside, takes the blended
//! motion of the surface around it: the mean displacement of the places near by, and about their mean the mean rotation and
//! uniform scale, so that an offset turns and grows but never shears or collapses. What counts as near is relative to the
//! distance of the surface: next to it a few triangles, far away all of it. The blend is Shepard's (1968) with the weights
//! of Franke and Nielson (1980), which end at a finite distance, over triangles instead of points and with far triangles
//! merged to clusters. It depends continuously on the point, also where the nearest place jumps.
//!
//! A motion is a pure function of the two shapes. A similarity of the whole surface carries every point with it; where the
//! surface around a point has kept its bits, so does the point.
//!
//! [`CarrySurface`] is the rest surface as a tree of clusters, [`SurfaceMotion`] how every sample of it has moved, turned and
//! grown in a deformed shape. [`CarriedPoints`] are points with their neighbourhoods, for many shapes; [`SurfaceCarrier`] is
//! for one. [`PackedPoints`] are for frames.

mod carried_points;
mod motion;
mod packed_lanes;
mod packed_motion;
mod packed_points;
mod sides;
mod stretch;
mod triangle_ball;

pub use carried_points::{CarriedPoints, SurfaceCarrier};
pub use motion::CarrySurface;
pub use motion::{CarriedFrame, SurfaceMotion};
pub use packed_motion::PackedMotion;
pub use packed_points::{LocalGradients, PackedPoints};
pub use stretch::{CarriedSpace, SurfaceStretch};
