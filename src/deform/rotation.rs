//! Rotation vectors: exponential, logarithm with any number of turns, and weighted means.
//!
//! A rotation vector is axis times angle in radians; 2π about an axis is a full turn and not nothing. Sines and cosines
//! come from `libm`, so that the same input gives the same bits everywhere.

use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::{PI, TAU};

/// The rotation by |v| radians about v.
pub fn exp_rotation(v: DVec3) -> DQuat {
    let angle = v.length();
    if angle < 1e-150 {
        return DQuat::IDENTITY;
    }
    let (sin, cos) = libm::sincos(0.5 * angle);
    let axis = v / angle * sin;
    DQuat::from_xyzw(axis.x, axis.y, axis.z, cos)
}

/// The rotation vector of at most half a turn that [`exp_rotation`] takes to `q` (or to −q, the same rotation).
pub fn log_rotation(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    let axis = DVec3::new(q.x, q.y, q.z);
    let sin = axis.length();
    // Near the identity the ratio angle / sin tends to 2 and needs no division.
    if sin < 1e-12 {
        axis * 2.0
    } else {
        axis * (2.0 * libm::atan2(sin, q.w) / sin)
    }
}

/// The rotation vector that leads from `base` to `target`, both unbounded rotation vectors: exp(base)·exp(result) is
/// exp(target), and of all vectors with that property the one nearest to their difference, so that turns are kept.
pub fn relative_rotation(base: DVec3, target: DVec3) -> DVec3 {
    if base == DVec3::ZERO {
        return target;
    }
    let wanted = target - base;
    let short = log_rotation(exp_rotation(base).inverse() * exp_rotation(target));
    let angle = short.length();
    // Along which axis turns may be added: the relative rotation's own, or, when that is none, the difference's.
    let Some(axis) = short
        .try_normalize()
        .filter(|_| angle > 1e-9)
        .or_else(|| wanted.try_normalize())
    else {
        return short;
    };
    let turns = libm::round((wanted.dot(axis) - short.dot(axis)) / TAU);
    short + axis * (turns * TAU)
}

/// A symmetric matrix of log-scales and a rotation vector, per handle, with the blending that they need.
///
/// `terms` are (weight, rotation vector relative to the base); the weights of the moved handles, the rest of the weight
/// belongs to the base. One term or one axis: exp(Σ u θ), exact for any number of turns. Otherwise that is the start of
/// `karcher` steps towards the Karcher mean, which the caller asks for only when no |θ| reaches half a turn.
pub fn blend_rotations(terms: &[(f64, DVec3)], karcher: usize) -> DQuat {
    let sum: DVec3 = terms.iter().map(|&(u, v)| v * u).sum();
    let mut mean = exp_rotation(sum);
    if terms.len() < 2 {
        return mean;
    }
    let base_weight = 1.0 - terms.iter().map(|t| t.0).sum::<f64>();
    for _ in 0..karcher {
        let back = mean.inverse();
        let step = log_rotation(back) * base_weight
            + terms
                .iter()
                .map(|&(u, v)| log_rotation(back * exp_rotation(v)) * u)
                .sum::<DVec3>();
        mean = (mean * exp_rotation(step)).normalize();
        if step.length_squared() < 1e-20 {
            break;
        }
    }
    mean
}

/// Whether the Karcher mean of these rotation vectors and the identity is safe: no two of them half a turn apart.
pub fn within_half_turn(vectors: &[DVec3]) -> bool {
    let bound = PI * 0.95;
    vectors.iter().all(|v| v.length() < bound)
        && vectors.iter().enumerate().all(|(i, a)| {
            let from_a = exp_rotation(*a).inverse();
            vectors[..i]
                .iter()
                .all(|b| log_rotation(from_a * exp_rotation(*b)).length() < bound)
        })
}

/// Whether all vectors lie on one line through the origin.
pub fn coaxial(vectors: &[DVec3]) -> bool {
    let Some(longest) = vectors
        .iter()
        .copied()
        .reduce(|a, b| if b.length_squared() > a.length_squared() { b } else { a })
    else {
        return true;
    };
    vectors
        .iter()
        .all(|v| v.cross(longest).length() <= 1e-9 * longest.length_squared())
}

/// exp of a symmetric matrix.
pub fn exp_symmetric(m: DMat3) -> DMat3 {
    let off = m.x_axis.y.abs() + m.x_axis.z.abs() + m.y_axis.z.abs();
    if off == 0.0 {
        return DMat3::from_diagonal(DVec3::new(
            libm::exp(m.x_axis.x),
            libm::exp(m.y_axis.y),
            libm::exp(m.z_axis.z),
        ));
    }
    // Halved until small, Taylor to the tenth power, squared back: exact to rounding for the scales that poses allow.
    let size = m.x_axis.length() + m.y_axis.length() + m.z_axis.length();
    let halvings = libm::ceil(libm::log2(size.max(1.0))).clamp(0.0, 60.0) as u32 + 2;
    let small = m * libm::ldexp(1.0, -(halvings as i32));
    let mut sum = DMat3::IDENTITY;
    let mut power = DMat3::IDENTITY;
    for k in 1..=12 {
        power = power * small * (1.0 / f64::from(k));
        sum += power;
    }
    for _ in 0..halvings {
        sum = sum * sum;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_undoes_exponential_below_half_a_turn() {
        for v in [
            DVec3::ZERO,
            DVec3::new(1e-14, 0., 0.),
            DVec3::new(0.3, -1.0, 2.0),
            DVec3::new(0., 3.1, 0.),
        ] {
            assert!((log_rotation(exp_rotation(v)) - v).length() < 1e-12, "{v}");
        }
    }

    #[test]
    fn whole_turns_are_kept_relative_to_a_turned_base() {
        let axis = DVec3::new(1., 2., 2.) / 3.0;
        let relative = relative_rotation(axis * 1.0, axis * (1.0 + 3.0 * TAU + 0.5));
        assert!((relative - axis * (3.0 * TAU + 0.5)).length() < 1e-9);
        let (a, b) = (DVec3::new(0.2, 0.4, -0.3), DVec3::new(-1.0, 0.5, 2.0));
        let q = exp_rotation(a) * exp_rotation(relative_rotation(a, b));
        assert!(q.angle_between(exp_rotation(b)) < 1e-7);
    }

    #[test]
    fn half_the_weight_turns_half_the_way() {
        let v = DVec3::new(0., 0., 5.0 * PI);
        assert!(blend_rotations(&[(0.5, v)], 3).angle_between(exp_rotation(v * 0.5)) < 1e-7);
    }

    #[test]
    fn the_karcher_mean_turns_with_the_scene() {
        let (a, b) = (DVec3::new(1.2, 0.1, 0.), DVec3::new(0., -0.9, 1.1));
        let scene = exp_rotation(DVec3::new(0.4, 2.0, -0.7));
        let plain = blend_rotations(&[(0.3, a), (0.4, b)], 20);
        let turned = blend_rotations(&[(0.3, scene * a), (0.4, scene * b)], 20);
        assert!((scene * plain * scene.inverse()).angle_between(turned) < 1e-7);
        assert!(within_half_turn(&[a, b]) && !coaxial(&[a, b]) && coaxial(&[a, a * -3.0]));
    }

    #[test]
    fn the_exponential_of_a_turned_scale_is_the_turned_scale() {
        let scale = DMat3::from_diagonal(DVec3::new(2.0, 0.5, 3.0));
        let log = DMat3::from_diagonal(DVec3::new(2f64.ln(), 0.5f64.ln(), 3f64.ln()));
        let r = DMat3::from_quat(exp_rotation(DVec3::new(0.3, 0.9, -0.5)));
        let difference = exp_symmetric(r * log * r.transpose()) - r * scale * r.transpose();
        assert!(difference.abs_diff_eq(DMat3::ZERO, 1e-12));
        assert!(exp_symmetric(log).abs_diff_eq(scale, 1e-12));
    }
}
