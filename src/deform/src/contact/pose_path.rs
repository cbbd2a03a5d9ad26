//! Poses that can be taken in parts.

use glam::DVec3;
use pliant_exec::progress::Cancelled;

/// Shapes of a pose that is taken in part only.
pub trait PosePath {
    /// Why there is none.
    type Error: From<Cancelled>;

    /// The places of all vertices with so much of the pose, from 0 to 1.
    ///
    /// # Errors
    /// [`PosePath::Error`].
    fn shape_at(&mut self, part: f64) -> Result<Vec<DVec3>, Self::Error>;
}

/// Where a shape is not that of a pose.
pub(super) enum NoPath {}

impl PosePath for NoPath {
    type Error = Cancelled;

    fn shape_at(&mut self, _part: f64) -> Result<Vec<DVec3>, Cancelled> {
        match *self {}
    }
}
