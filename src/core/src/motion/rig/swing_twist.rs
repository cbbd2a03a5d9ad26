//! Turns split into a twist about an axis and a swing of that axis.

use glam::{DQuat, DVec3};

/// The angle in −π … π by which `rotation` twists about a unit axis: it is a swing of the axis after that twist. 0 where the
/// axis is reversed, so that the twist is undefined.
pub(super) fn twist_angle(rotation: DQuat, axis: DVec3) -> f64 {
    let (along, w) = (rotation.xyz().dot(axis), rotation.w);
    if along * along + w * w < 1e-12 {
        return 0.0;
    }
    let half = libm::atan2(along, w);
    let turn = std::f64::consts::TAU;
    // Half the angle is told up to half a turn.
    match 2.0 * half {
        angle if angle > 0.5 * turn => angle - turn,
        angle if angle < -0.5 * turn => angle + turn,
        angle => angle,
    }
}

/// A rotation by an angle about a unit axis.
pub(super) fn rotation_about(axis: DVec3, angle: f64) -> DQuat {
    let axis = axis * libm::sin(0.5 * angle);
    DQuat::from_xyzw(axis.x, axis.y, axis.z, libm::cos(0.5 * angle))
}

/// Half-way between two rotations, along the shorter way.
pub(super) fn half_way(a: DQuat, b: DQuat) -> DQuat {
    let sum = if a.dot(b) < 0.0 { a - b } else { a + b };
    match sum.length_squared() > 1e-12 {
        true => sum.normalize(),
        false => a,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twist_and_swing_are_told_apart() {
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
