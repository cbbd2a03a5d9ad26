//! Weighted sums over vertices that give the motion of a neighbourhood: its rotation, and where it moves a place.

use crate::mesh::rotation::{fit_rotation, outer_product};
use glam::{DMat3, DQuat, DVec3};

/// How much of a rotation that is known from elsewhere is mixed into a fit, so that points in a line or in one place, which
/// leave their rotation open, take that one. Far below what a shape says, far above rounding.
const HINT: f64 = 1e-6;

/// How stiff the neighbourhood of a place is beyond its rotation and scale, relative to how far it reaches in each direction:
/// along directions in which no points lie it keeps to them.
const STIFFNESS: f64 = 1e-2;

/// Sums over vertices, relative to the first of them, so that few vertices far from the place lose no digits.
#[derive(Debug, Clone, Copy)]
pub(super) struct MotionMoments {
    weight: f64,
    /// The first vertex: rest offset from the place, and displacement.
    first: [DVec3; 2],
    /// Sum of rest offsets.
    offset: DVec3,
    /// Sum of displacements.
    shift: DVec3,
    /// Sum of offset times offset, transposed.
    spread: DMat3,
    /// Sum of displacement times offset, transposed.
    turned: DMat3,
}

impl Default for MotionMoments {
    fn default() -> Self {
        Self {
            weight: 0.0,
            first: [DVec3::ZERO; 2],
            offset: DVec3::ZERO,
            shift: DVec3::ZERO,
            spread: DMat3::ZERO,
            turned: DMat3::ZERO,
        }
    }
}

/// The mean offset and displacement, and the sums about them.
struct CentredMoments {
    offset: DVec3,
    shift: DVec3,
    spread: DMat3,
    turned: DMat3,
}

impl MotionMoments {
    /// Adds a vertex at `offset` from the place, which has moved by `shift`.
    pub(super) fn add(&mut self, weight: f64, offset: DVec3, shift: DVec3) {
        if self.is_empty() {
            self.first = [offset, shift];
        }
        let (offset, shift) = (offset - self.first[0], shift - self.first[1]);
        self.weight += weight;
        self.offset += offset * weight;
        self.shift += shift * weight;
        self.spread += outer_product(offset, offset) * weight;
        self.turned += outer_product(shift, offset) * weight;
    }

    /// Whether they say anything.
    pub(super) fn is_empty(&self) -> bool {
        self.weight <= 0.0
    }

    fn centred(&self) -> CentredMoments {
        let offset = self.offset / self.weight;
        let shift = self.shift / self.weight;
        CentredMoments {
            offset: self.first[0] + offset,
            shift: self.first[1] + shift,
            spread: self.spread - outer_product(self.offset, offset),
            turned: self.turned - outer_product(self.shift, offset),
        }
    }

    /// The rotation that fits best (Kabsch 1976, never a reflection); what the vertices leave open is as in `hint`.
    pub(super) fn rotation(&self, hint: &DMat3) -> DQuat {
        if self.is_empty() {
            return fit_rotation(*hint);
        }
        let CentredMoments { spread, turned, .. } = self.centred();
        let size = trace(&spread);
        if size.is_nan() || size <= 0.0 {
            return fit_rotation(*hint);
        }
        fit_rotation(spread + turned + *hint * (HINT * size))
    }

    /// By how much the place itself moves, when the neighbourhood turns by `rotation`: the affine map that fits best in the
    /// sense of least squares, which keeps to that rotation and a uniform scale where the vertices leave it open.
    pub(super) fn shift_of_place(&self, rotation: &DMat3) -> DVec3 {
        let CentredMoments {
            offset,
            shift,
            spread,
            turned,
        } = self.centred();
        let size = trace(&spread);
        if size.is_nan() || size <= 0.0 {
            return shift - (*rotation - DMat3::IDENTITY) * offset;
        }
        let grown = trace(&(rotation.transpose() * (spread + turned))) / size;
        let similarity = *rotation * grown.max(0.0) - DMat3::IDENTITY;
        let stiff = spread + DMat3::from_diagonal(DVec3::splat(STIFFNESS * size / 3.0));
        let rest = (turned - similarity * spread) * stiff.inverse();
        let at_place = shift - (similarity + rest) * offset;
        if at_place.is_finite() { at_place } else { shift }
    }
}

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::rotation::exp_rotation;

    fn moments(points: &[DVec3], place: DVec3, map: impl Fn(DVec3) -> DVec3) -> MotionMoments {
        let mut all = MotionMoments::default();
        points.iter().for_each(|&p| all.add(0.5, p - place, map(p) - p));
        all
    }

    #[test]
    fn a_place_moves_with_an_affine_map_of_what_is_around() {
        let points: Vec<DVec3> = (0..60)
            .map(|i| DVec3::new(f64::from(i % 3), f64::from(i % 5), f64::from(i % 4)))
            .collect();
        let place = DVec3::new(0.7, 2.1, 1.9);
        let turn = exp_rotation(DVec3::new(0.3, 2.9, -0.4));
        let moved = |p: DVec3| turn * (p * 1.5) + DVec3::new(4.0, 0.0, 1.0);
        let sums = moments(&points, place, moved);
        let found = sums.rotation(&DMat3::IDENTITY);
        assert!(found.dot(turn).abs() > 1.0 - 1e-9);
        let to = place + sums.shift_of_place(&DMat3::from_quat(found));
        assert!((to - moved(place)).length() < 1e-4, "{to} {}", moved(place));
        // Longer along one axis alone: up to the stiffness.
        let stretched = |p: DVec3| DVec3::new(p.x, p.y * 1.5, p.z);
        let sums = moments(&points, place, stretched);
        let to = place + sums.shift_of_place(&DMat3::from_quat(sums.rotation(&DMat3::IDENTITY)));
        assert!((to - stretched(place)).length() < 3e-3, "{to} {}", stretched(place));
    }

    #[test]
    fn what_points_leave_open_is_taken_from_the_hint() {
        let hint = exp_rotation(DVec3::X * 1.25);
        let one = moments(&[DVec3::Y], DVec3::ZERO, |p| p + DVec3::Z);
        assert!(one.rotation(&DMat3::from_quat(hint)).dot(hint).abs() > 1.0 - 1e-12);
        // A single vertex takes the place along, turned about it.
        let to = one.shift_of_place(&DMat3::from_quat(hint));
        assert!((to - (DVec3::Y + DVec3::Z - hint * DVec3::Y)).length() < 1e-12, "{to}");
        // A line along x does not tell how it turned about itself.
        let line = moments(&[DVec3::ZERO, DVec3::X, DVec3::X * 2.0], DVec3::ZERO, |p| p);
        assert!(line.rotation(&DMat3::from_quat(hint)).dot(hint).abs() > 1.0 - 1e-9);
    }
}
