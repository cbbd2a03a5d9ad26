//! The rigid motion that fits one set of points to another best: never a reflection.

use crate::deform::transform::Transform;
use crate::mesh::rotation::{fit_rotation, log_rotation, outer_product};
use glam::{DMat3, DVec3};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::rotation::exp_rotation;

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
