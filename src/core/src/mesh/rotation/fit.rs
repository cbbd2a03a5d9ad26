//! The rotation that fits one set of points to another best (Horn 1987): never a reflection.

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

/// x pᵀ.
pub fn outer_product(x: DVec3, p: DVec3) -> DMat3 {
    DMat3::from_cols(x * p.x, x * p.y, x * p.z)
}
