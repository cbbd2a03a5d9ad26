//! The rotation, or rigid motion, that fits one set of points to another best (Horn 1987): never a reflection.

use crate::deform::rotation::vector::log_rotation;
use crate::deform::transform::Transform;
use glam::{DMat3, DQuat, DVec3};

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

/// Finds the rigid motion that takes `rest` nearest to `deformed` in the least-squares sense.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::deform::{exp_rotation, fit_rigid_motion};
///
/// let rest = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
/// let turned = rest.map(|p| exp_rotation(DVec3::Z) * p + DVec3::X);
/// let motion = fit_rigid_motion(&rest, &turned).map();
/// assert!(rest.iter().zip(turned).all(|(p, q)| motion(*p).distance(q) < 1e-9));
/// ```
pub fn fit_rigid_motion(rest: &[DVec3], deformed: &[DVec3]) -> Transform {
    let count = rest.len().min(deformed.len());
    if count == 0 {
        return Transform::IDENTITY;
    }
    let rest_mean = rest.iter().sum::<DVec3>() / count as f64;
    let mean = deformed.iter().sum::<DVec3>() / count as f64;
    let mut covariance = DMat3::ZERO;
    for (p, x) in rest.iter().zip(deformed) {
        covariance += outer_product(*x - mean, *p - rest_mean);
    }
    Transform {
        translation: mean - rest_mean,
        rotation: log_rotation(fit_rotation(covariance)),
        log_scale: DMat3::ZERO,
        pivot: rest_mean,
    }
}

/// x pᵀ.
pub fn outer_product(x: DVec3, p: DVec3) -> DMat3 {
    DMat3::from_cols(x * p.x, x * p.y, x * p.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::rotation::vector::exp_rotation;

    #[test]
    fn a_rigid_motion_is_found_again_and_a_mirror_image_gives_no_reflection() {
        let rest: Vec<_> = [[0., 0., 0.], [1., 0., 0.], [0., 2., 0.], [0., 0., 3.], [1., 1., 1.]]
            .map(DVec3::from_array)
            .to_vec();
        for rotation in [
            DVec3::ZERO,
            DVec3::new(0.1, 0., 0.),
            DVec3::new(1.0, -2.0, 0.5),
            DVec3::new(0., 0., 3.1),
        ] {
            let moved: Vec<_> = rest
                .iter()
                .map(|&p| exp_rotation(rotation) * p + DVec3::new(7., 8., 9.))
                .collect();
            let map = fit_rigid_motion(&rest, &moved).map();
            for (p, x) in rest.iter().zip(&moved) {
                assert!((map(*p) - *x).length() < 1e-9, "{rotation}");
            }
        }
        let mirrored: Vec<_> = rest.iter().map(|p| DVec3::new(-p.x, p.y, p.z)).collect();
        assert!((fit_rigid_motion(&rest, &mirrored).linear().determinant() - 1.0).abs() < 1e-9);
    }
}
