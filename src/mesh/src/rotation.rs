//! Rotations as vectors, as the turning part of a matrix, and fitted to points; sines and cosines come from `libm`.
//!
//! Rotation vectors: exponential, and logarithm with any number of turns; the rotational part of a matrix.
//!
//! A rotation vector is axis times angle in radians; 2π about an axis is a full turn and not nothing. Sines and cosines
//! come from `libm`, so that the same input gives the same bits everywhere.
//!
//! The rotation that fits one set of points to another best (Horn 1987): never a reflection.

use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::TAU;

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

/// Newton steps towards the nearest rotation; from the one of a similar matrix two or three are enough.
const NEAREST_STEPS: usize = 30;

/// The rotation R that makes tr(Rᵀ a) largest, found from `start`: the rotational part of `a`.
///
/// Always a rotation and never a reflection: where `a` is inverted it is the nearest proper one, and a matrix that does
/// not determine a rotation (of rank one, or 0) keeps what it leaves open from `start`.
///
/// For R exp(ω) the trace is tr B + g·ω − ½ ωᵀ (tr(S) I − S) ω with B = Rᵀ a and S its symmetric part. Where that
/// matrix is positive the Newton step is taken, elsewhere one along g that cannot be too long.
pub fn nearest_rotation(a: DMat3, start: DQuat) -> DQuat {
    nearest_rotation_within(a, start, 1e-12)
}

/// As [`nearest_rotation`], ending with the first step whose square is below `last_step_squared`, radians: about that much is
/// left.
pub fn nearest_rotation_within(a: DMat3, start: DQuat, last_step_squared: f64) -> DQuat {
    let size = (a.x_axis.length_squared() + a.y_axis.length_squared() + a.z_axis.length_squared()).sqrt();
    if !(size > 0.0 && size.is_finite()) {
        return start;
    }
    let a = a * (1.0 / size);
    let mut q = start;
    for _ in 0..NEAREST_STEPS {
        let b = DMat3::from_quat(q).transpose() * a;
        let gradient = DVec3::new(
            b.y_axis.z - b.z_axis.y,
            b.z_axis.x - b.x_axis.z,
            b.x_axis.y - b.y_axis.x,
        );
        let trace = b.x_axis.x + b.y_axis.y + b.z_axis.z;
        let off = DVec3::new(
            0.5 * (b.y_axis.z + b.z_axis.y),
            0.5 * (b.z_axis.x + b.x_axis.z),
            0.5 * (b.x_axis.y + b.y_axis.x),
        );
        let diagonal = DVec3::splat(trace) - DVec3::new(b.x_axis.x, b.y_axis.y, b.z_axis.z);
        let step = newton_step(diagonal, off, gradient)
            .filter(|step| step.length_squared() < 1.0)
            .unwrap_or_else(|| gradient / (trace.abs() + gradient.length() + 1e-9));
        q = (q * DQuat::from_xyzw(0.5 * step.x, 0.5 * step.y, 0.5 * step.z, 1.0)).normalize();
        if step.length_squared() < last_step_squared {
            break;
        }
    }
    q
}

/// Solves H ω = g for the symmetric H with `diagonal` and −`off` (yz, zx, xy); `None` unless H is clearly positive.
fn newton_step(diagonal: DVec3, off: DVec3, g: DVec3) -> Option<DVec3> {
    const LEAST: f64 = 1e-6;
    let (yz, zx, xy) = (-off.x, -off.y, -off.z);
    if diagonal.x < LEAST {
        return None;
    }
    let (l_y, l_z) = (xy / diagonal.x, zx / diagonal.x);
    let d_y = diagonal.y - l_y * xy;
    if d_y < LEAST {
        return None;
    }
    let l_zy = (yz - l_z * xy) / d_y;
    let d_z = diagonal.z - l_z * zx - l_zy * l_zy * d_y;
    if d_z < LEAST {
        return None;
    }
    let y = g.y - l_y * g.x;
    let z = (g.z - l_z * g.x - l_zy * y) / d_z;
    let y = y / d_y - l_zy * z;
    Some(DVec3::new(g.x / diagonal.x - l_y * y - l_z * z, y, z))
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

/// The rotation R that maximises trace(R Cᵀ) for a covariance C = Σ w (x)(p)ᵀ of deformed x and rest p; the identity
/// where C says nothing.
pub fn fit_rotation(covariance: DMat3) -> DQuat {
    let size = covariance.x_axis.length() + covariance.y_axis.length() + covariance.z_axis.length();
    if !(size > 0.0 && size.is_finite()) {
        return DQuat::IDENTITY;
    }
    let c = covariance * (1.0 / size);
    // Element (row a, column b) is Σ x_a p_b; Horn's matrix with S_ba = that.
    let s = |rest: usize, deformed: usize| c.col(rest)[deformed];
    let (xx, yy, zz) = (s(0, 0), s(1, 1), s(2, 2));
    let mut m = [
        [xx + yy + zz, s(1, 2) - s(2, 1), s(2, 0) - s(0, 2), s(0, 1) - s(1, 0)],
        [0.0, xx - yy - zz, s(0, 1) + s(1, 0), s(2, 0) + s(0, 2)],
        [0.0, 0.0, yy - xx - zz, s(1, 2) + s(2, 1)],
        [0.0, 0.0, 0.0, zz - xx - yy],
    ];
    for i in 0..4 {
        for j in 0..i {
            m[i][j] = m[j][i];
        }
    }
    let v = largest_eigenvector(m);
    DQuat::from_xyzw(v[1], v[2], v[3], v[0]).normalize()
}

/// The eigenvector of the largest eigenvalue of a symmetric 4×4 matrix, by cyclic Jacobi rotations.
fn largest_eigenvector(mut a: [[f64; 4]; 4]) -> [f64; 4] {
    let mut v = [[0.0; 4]; 4];
    for (i, row) in v.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for _sweep in 0..16 {
        let off: f64 = (0..4)
            .flat_map(|i| (0..i).map(move |j| (i, j)))
            .map(|(i, j)| a[i][j] * a[i][j])
            .sum();
        if off < 1e-30 {
            break;
        }
        for p in 0..3 {
            for q in p + 1..4 {
                if a[p][q].abs() < 1e-300 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let t = if theta == 0.0 { 1.0 } else { t };
                let cos = 1.0 / (t * t + 1.0).sqrt();
                let sin = t * cos;
                for k in 0..4 {
                    let (x, y) = (a[k][p], a[k][q]);
                    (a[k][p], a[k][q]) = (cos * x - sin * y, sin * x + cos * y);
                }
                for k in 0..4 {
                    let (x, y) = (a[p][k], a[q][k]);
                    (a[p][k], a[q][k]) = (cos * x - sin * y, sin * x + cos * y);
                }
                for row in &mut v {
                    let (x, y) = (row[p], row[q]);
                    (row[p], row[q]) = (cos * x - sin * y, sin * x + cos * y);
                }
            }
        }
    }
    let mut best = 0;
    for k in 1..4 {
        if a[k][k] > a[best][best] {
            best = k;
        }
    }
    [v[0][best], v[1][best], v[2][best], v[3][best]]
}

/// x pᵀ.
pub fn outer_product(x: DVec3, p: DVec3) -> DMat3 {
    DMat3::from_cols(x * p.x, x * p.y, x * p.z)
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
    fn the_nearest_rotation_is_the_rotational_part() {
        let turn = |v: DVec3| DMat3::from_quat(exp_rotation(v));
        for k in 0..200 {
            let angle = |s: f64| libm::sin(f64::from(k) * s + s);
            let r = DVec3::new(angle(1.3), angle(2.1), angle(3.7)) * 1.7;
            let v = turn(DVec3::new(angle(0.7), angle(5.1), angle(0.3)) * 3.0);
            let stretch = v * DMat3::from_diagonal(DVec3::new(2.0, 0.7, 0.1 + 0.3 * angle(9.0).abs())) * v.transpose();
            let found = nearest_rotation(turn(r) * stretch * 1e-9, DQuat::IDENTITY);
            assert!(found.angle_between(exp_rotation(r)) < 1e-6, "{k}");
            // Inverted along its shortest axis: the same rotation, not a reflection and not another one.
            let inverted = v * DMat3::from_diagonal(DVec3::new(2.0, 0.7, -0.1)) * v.transpose();
            let found = nearest_rotation(turn(r) * inverted, exp_rotation(r * 0.8));
            assert!(found.angle_between(exp_rotation(r)) < 1e-5, "{k} inverted");
        }
    }

    #[test]
    fn what_a_matrix_leaves_open_stays() {
        let start = exp_rotation(DVec3::new(0.4, 0.0, 0.0));
        for nothing in [DMat3::ZERO, DMat3::NAN] {
            assert_eq!(nearest_rotation(nothing, start), start);
        }
        // One edge along x that now points along y: turned there, and no further about itself.
        let edge = DMat3::from_cols(DVec3::Y, DVec3::ZERO, DVec3::ZERO);
        let found = nearest_rotation(edge, DQuat::IDENTITY);
        assert!((found * DVec3::X - DVec3::Y).length() < 1e-6);
        assert!((found * DVec3::Z - DVec3::Z).length() < 1e-6);
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
