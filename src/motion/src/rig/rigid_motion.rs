//! Rigid motions as a turn about a point that goes somewhere.
//!
//! Turns split into a twist about an axis and a swing of that axis.

use glam::{DQuat, DVec3};
use pliant_mesh::rotation::{exp_rotation, log_rotation};

/// Takes a point x to R (x − from) + to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidMotion {
    /// R, of unit length.
    pub rotation: DQuat,
    /// The point about which it turns, before.
    pub from: DVec3,
    /// Where that point goes.
    pub to: DVec3,
}

impl RigidMotion {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        from: DVec3::ZERO,
        to: DVec3::ZERO,
    };

    /// Where a point goes.
    pub fn place(&self, point: DVec3) -> DVec3 {
        self.rotation * (point - self.from) + self.to
    }

    /// Where a point comes from.
    pub fn place_back(&self, point: DVec3) -> DVec3 {
        self.rotation.inverse() * (point - self.to) + self.from
    }

    /// This motion, and then another.
    #[must_use]
    pub fn followed_by(&self, next: &Self) -> Self {
        Self {
            rotation: (next.rotation * self.rotation).normalize(),
            from: self.from,
            to: next.place(self.to),
        }
    }

    /// The motion as a point moved along with `frame` sees it: first this one, then back what `frame` did.
    ///
    /// ```
    /// use glam::{DQuat, DVec3};
    /// use pliant_motion::rig::RigidMotion;
    /// let turn = RigidMotion { rotation: DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0), from: DVec3::X, to: DVec3::Y };
    /// let seen = turn.seen_from(&turn);
    /// assert!(seen.place(DVec3::Z).distance(DVec3::Z) < 1e-15);
    /// ```
    #[must_use]
    pub fn seen_from(&self, frame: &Self) -> Self {
        let back = frame.rotation.inverse();
        Self {
            rotation: (back * self.rotation).normalize(),
            from: self.from,
            to: back * (self.to - frame.to) + frame.from,
        }
    }

    /// So much of the motion, 0 to 1: of the turn, the shorter way, and of the way of its point.
    #[must_use]
    pub(super) fn part_way(&self, part: f64) -> Self {
        Self {
            rotation: exp_rotation(log_rotation(self.rotation) * part),
            from: self.from,
            to: self.from.lerp(self.to, part),
        }
    }
}

/// The angle in −π … π by which `rotation` twists about a unit axis: it is a swing of the axis after that twist. 0 where the
/// axis is reversed, so that the twist is undefined.
pub(super) fn twist_angle(rotation: DQuat, axis: DVec3) -> f64 {
    let (along, w) = (rotation.xyz().dot(axis), rotation.w);
    if along * along + w * w < 1e-12 {
        return 0.0;
    }
    let half = libm::atan2(along, w);
    let turn = std::f64::consts::TAU;
    // Half the angle is known up to half a turn.
    match 2.0 * half {
        angle if angle > 0.5 * turn => angle - turn,
        angle if angle < -0.5 * turn => angle + turn,
        angle => angle,
    }
}

/// A twist of a bone that swings by more than 160 degrees is not clear: the square of the cosine of half of that.
const LEAST_CLEAR: f64 = 0.03;

/// The same; `None` where the axis is swung so far that the twist is not clear.
pub(super) fn clear_twist(rotation: DQuat, axis: DVec3) -> Option<f64> {
    let (along, w) = (rotation.xyz().dot(axis), rotation.w);
    (along * along + w * w >= LEAST_CLEAR).then(|| twist_angle(rotation, axis))
}

/// A rotation by an angle about a unit axis.
pub(super) fn rotation_about(axis: DVec3, angle: f64) -> DQuat {
    let axis = axis * libm::sin(0.5 * angle);
    DQuat::from_xyzw(axis.x, axis.y, axis.z, libm::cos(0.5 * angle))
}

/// Half-way between two rotations, along the shorter way, or along the other one.
pub(super) fn half_way(a: DQuat, b: DQuat, is_far: bool) -> DQuat {
    let sum = if (a.dot(b) < 0.0) != is_far { a - b } else { a + b };
    match sum.length_squared() > 1e-12 {
        true => sum.normalize(),
        false => a,
    }
}

#[cfg(test)]
mod swing_twist_tests {
    use super::*;

    #[test]
    fn twist_and_swing_are_distinguished() {
        let (axis, across) = (DVec3::Z, DVec3::X);
        for angle in [-3.0, -1.2, 0.0, 0.4, 2.6, 3.1] {
            for bend in [-2.5, 0.0, 1.0] {
                for sign in [1.0, -1.0] {
                    let whole = rotation_about(across, bend) * rotation_about(axis, angle) * sign;
                    assert!((twist_angle(whole, axis) - angle).abs() < 1e-12, "{angle} {bend}");
                }
            }
        }
        assert_eq!(twist_angle(DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0), axis), 0.0);
    }
}
