//! How far two surfaces are apart, whatever their triangles.

use crate::mesh::query::TriangleBvh;
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// Computes the symmetric Hausdorff distance of two surfaces and the point of either where it is largest: of all vertices and
/// triangle centres of one surface the farthest from the nearest point of the other's triangles, both ways. `None` when
/// either has no triangle.
///
/// The farthest point of a surface need not be a vertex or a centre, so the true distance may be larger, by no more than
/// a triangle's size.
///
/// ```
/// use glam::DVec3;
/// use pliant::{check::hausdorff_distance, pool::Pool};
///
/// let low = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// let high = low.map(|p| p + DVec3::Z * 0.5);
/// let distance = hausdorff_distance((&low, &[[0, 1, 2]]), (&high, &[[0, 1, 2]]), &Pool::new(1)?);
/// assert_eq!(distance.map(|(length, _)| length), Some(0.5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Panics
/// When a triangle names a position that does not exist.
pub fn hausdorff_distance(a: (&[DVec3], &[[u32; 3]]), b: (&[DVec3], &[[u32; 3]]), pool: &Pool) -> Option<(f64, DVec3)> {
    let one = farthest(a, b, pool)?;
    let other = farthest(b, a, pool)?;
    Some(if other.0 > one.0 { other } else { one })
}

/// The point of `from` that is farthest from `to`; the first of several.
fn farthest(from: (&[DVec3], &[[u32; 3]]), to: (&[DVec3], &[[u32; 3]]), pool: &Pool) -> Option<(f64, DVec3)> {
    let (positions, triangles) = from;
    let tree = TriangleBvh::build(to.0, to.1, pool);
    let used = {
        let mut used = vec![false; positions.len()];
        triangles.as_flattened().iter().for_each(|&v| used[v as usize] = true);
        used
    };
    let vertices = positions.iter().zip(&used).filter(|(_, used)| **used).map(|(p, _)| *p);
    let centres = triangles
        .iter()
        .map(|t| t.map(|v| positions[v as usize]).iter().sum::<DVec3>() / 3.0);
    let points: Vec<DVec3> = vertices.chain(centres).collect();
    let distances: Vec<f64> = pool.install(|| {
        let distance = |&p: &DVec3| tree.closest_point(p).map_or(f64::INFINITY, |n| n.distance);
        points.par_iter().map(distance).collect()
    });
    let mut worst: Option<(f64, DVec3)> = None;
    for (distance, point) in distances.into_iter().zip(points) {
        if distance.is_finite() && worst.is_none_or(|w| distance > w.0) {
            worst = Some((distance, point));
        }
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;

    fn pool() -> Pool {
        Pool::new(2).expect("threads")
    }

    fn of(a: &shapes::Shape, b: &shapes::Shape) -> f64 {
        hausdorff_distance((&a.0, &a.1), (&b.0, &b.1), &pool())
            .expect("surfaces")
            .0
    }

    #[test]
    fn it_is_the_distance_of_surfaces_and_not_of_vertices() {
        // The same sheet with other triangles: no vertex of one is near a vertex of the other, the surfaces are one.
        let (coarse, fine) = (shapes::grid(1.0, 1.0, [2, 2]), shapes::grid(1.0, 1.0, [7, 5]));
        assert!(of(&coarse, &fine) < 1e-12);
        let mut raised = fine.clone();
        raised
            .0
            .iter_mut()
            .for_each(|p| *p += DVec3::splat(0.0).with_y(0.25).with_z(0.25));
        let apart = of(&coarse, &raised);
        assert!(apart > 0.24 && apart <= 0.25 * 2f64.sqrt() + 1e-12, "{apart}");
    }

    #[test]
    fn it_sees_what_one_side_alone_has() {
        let ball = shapes::icosphere(1.0, 3);
        // A ball and the same with a spike: seen from the ball, the spike is close to it nowhere.
        let mut spiked = ball.clone();
        spiked.0[0] *= 2.0;
        let (there, back) = (of(&ball, &spiked), of(&spiked, &ball));
        assert_eq!(there.to_bits(), back.to_bits());
        assert!((there - 1.0).abs() < 1e-9, "{there}");
    }

    #[test]
    fn without_triangles_there_is_none() {
        let ball = shapes::icosphere(1.0, 1);
        assert_eq!(hausdorff_distance((&ball.0, &[]), (&ball.0, &ball.1), &pool()), None);
    }
}
