//! Balls around triangles: by its ball a triangle that is too far away is passed over.

use glam::DVec3;

/// A ball around a triangle.
#[derive(Debug, Clone, Copy)]
pub(super) struct TriangleBall {
    center: DVec3,
    radius: f64,
}

/// How much larger a ball is than the one that touches the corners, more than distances round by: in parts of its radius, and of how far
/// it is from the origin.
const BALL_MARGIN: f64 = 1.0 + 1e-6;
const PLACE_MARGIN: f64 = 1e-14;

impl TriangleBall {
    /// Around the triangle of these corners.
    pub fn around(corners: [DVec3; 3]) -> Self {
        let center = corners.iter().sum::<DVec3>() / 3.0;
        let farthest = corners
            .map(|corner| corner.distance_squared(center))
            .into_iter()
            .fold(0.0, f64::max);
        Self {
            center,
            radius: BALL_MARGIN * farthest.sqrt() + PLACE_MARGIN * center.length(),
        }
    }

    /// Whether all of the triangle is farther from `point` than this, for certain.
    #[inline]
    pub fn is_beyond(&self, point: DVec3, distance: f64) -> bool {
        let reach = BALL_MARGIN * (self.radius + distance);
        self.center.distance_squared(point) > reach * reach
    }
}
