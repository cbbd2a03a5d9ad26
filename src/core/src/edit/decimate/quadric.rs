//! Squared distances to planes, summed (Garland and Heckbert 1997).

use glam::DVec3;
use std::ops::AddAssign;

/// The sum of weighted squared distances to planes, as a function of the place: xᵀAx + 2bᵀx + c with A symmetric.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Quadric {
    diagonal: DVec3,
    /// yz, zx, xy.
    mixed: DVec3,
    linear: DVec3,
    constant: f64,
}

impl Quadric {
    /// The plane through `at` with unit normal `n`. Nothing when a number is not finite.
    pub fn from_plane(n: DVec3, at: DVec3, weight: f64) -> Self {
        let offset = -n.dot(at);
        let value = Self {
            diagonal: n * n * weight,
            mixed: DVec3::new(n.y * n.z, n.z * n.x, n.x * n.y) * weight,
            linear: n * (offset * weight),
            constant: offset * offset * weight,
        };
        let finite = value.diagonal.is_finite() && value.linear.is_finite() && value.constant.is_finite();
        if finite { value } else { Self::default() }
    }

    /// The sum at `x`, never negative.
    pub fn error_at(&self, x: DVec3) -> f64 {
        let squares = self.diagonal.dot(x * x);
        let products = self.mixed.dot(DVec3::new(x.y * x.z, x.z * x.x, x.x * x.y));
        (squares + 2.0 * (products + self.linear.dot(x)) + self.constant).max(0.0)
    }
}

impl AddAssign for Quadric {
    fn add_assign(&mut self, other: Self) {
        self.diagonal += other.diagonal;
        self.mixed += other.mixed;
        self.linear += other.linear;
        self.constant += other.constant;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_sum_of_weighted_squared_distances() {
        let planes = [
            (DVec3::X, DVec3::ONE, 2.0),
            (DVec3::new(1.0, -2.0, 0.5).normalize(), DVec3::new(0.3, 0.1, -4.0), 0.7),
        ];
        let mut q = Quadric::default();
        for (n, at, w) in planes {
            q += Quadric::from_plane(n, at, w);
        }
        let x = DVec3::new(2.0, -1.0, 0.4);
        let expected: f64 = planes.iter().map(|(n, at, w)| w * (x - *at).dot(*n).powi(2)).sum();
        assert!((q.error_at(x) - expected).abs() < 1e-12);
        assert_eq!(Quadric::from_plane(DVec3::NAN, DVec3::ONE, 1.0), Quadric::default());
    }
}
