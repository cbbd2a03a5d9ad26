//! Where a handle is: scaled, then rotated about its pivot, then translated.

use crate::mesh::rotation::{exp_rotation, exp_symmetric};
use glam::{DMat3, DVec3};

/// A handle's pose in model space: x' = R S (x − pivot) + pivot + translation.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::deform::Transform;
///
/// let quarter_turn = Transform {
///     rotation: DVec3::Z * std::f64::consts::FRAC_PI_2,
///     pivot: DVec3::X,
///     ..Transform::IDENTITY
/// };
/// let moved = quarter_turn.map()(DVec3::X * 2.0);
/// assert!(moved.distance(DVec3::new(1.0, 1.0, 0.0)) < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform {
    /// Model units.
    pub translation: DVec3,
    /// Axis times angle in radians, any number of turns.
    pub rotation: DVec3,
    /// Symmetric matrix whose exponential is the scale S: logarithms on the diagonal for a scale along the axes.
    pub log_scale: DMat3,
    /// The point that scaling and rotation leave where it is.
    pub pivot: DVec3,
}

impl Transform {
    /// Leaves everything as it is.
    pub const IDENTITY: Self = Self {
        translation: DVec3::ZERO,
        rotation: DVec3::ZERO,
        log_scale: DMat3::ZERO,
        pivot: DVec3::ZERO,
    };

    /// Whether every point keeps its bits. A full turn is not the identity: it twists what lies between.
    pub fn is_identity(&self) -> bool {
        self.translation == DVec3::ZERO && self.rotation == DVec3::ZERO && self.log_scale == DMat3::ZERO
    }

    /// R S, the linear part.
    pub fn linear(&self) -> DMat3 {
        let rotation = DMat3::from_quat(exp_rotation(self.rotation));
        if self.log_scale == DMat3::ZERO {
            rotation
        } else {
            rotation * exp_symmetric(self.log_scale)
        }
    }

    /// The affine map as a closure, with its matrix computed once. The identity returns its argument's bits.
    pub fn map(&self) -> impl Fn(DVec3) -> DVec3 + Send + Sync + use<> {
        let (identity, linear) = (self.is_identity(), self.linear());
        let (pivot, shift) = (self.pivot, self.pivot + self.translation);
        move |p| if identity { p } else { linear * (p - pivot) + shift }
    }

    /// The transform seen in the mirror of the plane through `point` with unit normal `normal`.
    pub fn mirrored(&self, normal: DVec3, point: DVec3) -> Self {
        let reflect = |v: DVec3| v - normal * (2.0 * normal.dot(v));
        let mirror = DMat3::from_cols(reflect(DVec3::X), reflect(DVec3::Y), reflect(DVec3::Z));
        Self {
            translation: reflect(self.translation),
            // A rotation vector is axial: it changes its sign on top of the reflection.
            rotation: -reflect(self.rotation),
            log_scale: mirror * self.log_scale * mirror,
            pivot: reflect(self.pivot - point) + point,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirrored_transform_moves_mirrored_points_to_mirrored_places() {
        let t = Transform {
            translation: DVec3::new(0.3, -1.0, 2.0),
            rotation: DVec3::new(0.7, 0.2, -1.9),
            log_scale: DMat3::from_diagonal(DVec3::new(0.2, -0.4, 0.1)),
            pivot: DVec3::new(1.0, 2.0, 3.0),
        };
        let (n, o) = (DVec3::new(2.0, -1.0, 2.0) / 3.0, DVec3::new(0.5, 0.5, 0.0));
        let reflect = |p: DVec3| p - n * (2.0 * n.dot(p - o));
        let (map, mirrored) = (t.map(), t.mirrored(n, o).map());
        for p in [DVec3::ZERO, DVec3::new(3.0, -2.0, 1.0)] {
            assert!((mirrored(reflect(p)) - reflect(map(p))).length() < 1e-12);
        }
    }
}
