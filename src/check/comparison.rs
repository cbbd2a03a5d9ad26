//! How far a result is from its golden, in numbers and places.

use super::case_result::{CaseResult, TopologyDigests};
use super::golden::Golden;
use super::metric::{Metric, format_point};
use crate::mesh::query::TriangleBvh;
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Worst places that are listed.
const WORST: usize = 3;
/// Worst places are at least this share of the diagonal apart.
const APART: f64 = 0.06;
/// Relative rounding of a 32-bit float, with room for one step more.
const ROUNDED: f64 = 2.4e-7;

/// A comparison measures a result against its golden.
#[derive(Debug, Clone, Default)]
pub struct GoldenComparison {
    /// The stored shape, moved towards the result within its precision.
    pub stored: Vec<DVec3>,
    /// Its triangles; `None` when they are not known.
    pub triangles: Option<Vec<[u32; 3]>>,
    /// What could be measured.
    pub numbers: BTreeMap<Metric, f64>,
    /// Where each is worst, in words.
    pub places: BTreeMap<Metric, String>,
    /// The vertices that are farthest from their stored places, farthest first, not close to one another.
    pub worst: Vec<u32>,
    /// Largest angle between a triangle's normal and the stored one, degrees.
    pub largest_angle: f64,
}

/// Compares a finite result with its golden. With another topology it measures only the distance of the surfaces.
pub fn compare_with_golden(found: &CaseResult, golden: &Golden, pool: &Pool) -> GoldenComparison {
    let same = TopologyDigests::from_triangles(found.positions.len(), &found.triangles) == golden.topology;
    let slack = if found.rounded { ROUNDED } else { 0.0 };
    let mut comparison = GoldenComparison {
        stored: golden.positions.nearest_to(&found.positions, slack),
        triangles: stored_triangles(found, golden, same),
        ..Default::default()
    };
    let diagonal = golden.positions.diagonal();
    let unit = if diagonal > 0.0 { diagonal } else { 1.0 };
    if same {
        comparison.measure_displacements(found, unit);
        comparison.measure_normals(found, pool);
        comparison.measure_edges(found, golden.positions.resolution() * unit, pool);
    }
    // The same bits are no distance apart, and need no search.
    let apart = match &comparison.triangles {
        Some(_) if same && comparison.stored == found.positions => Some((0.0, DVec3::ZERO)),
        Some(triangles) => hausdorff_distance(&comparison.stored, triangles, &found.positions, &found.triangles, pool),
        None => None,
    };
    if let Some((distance, point)) = apart {
        comparison.record_metric(Metric::Hausdorff, distance / unit, || {
            format!("at {}", format_point(point))
        });
    }
    comparison
}

/// The triangles of the stored shape: kept in the golden, or those of the result or the model when they are the same.
fn stored_triangles(found: &CaseResult, golden: &Golden, same: bool) -> Option<Vec<[u32; 3]>> {
    if same {
        return Some(found.triangles.clone());
    }
    if let Some(kept) = &golden.triangles {
        return Some(kept.clone());
    }
    let (positions, triangles) = &found.before;
    (TopologyDigests::from_triangles(positions.len(), triangles) == golden.topology).then(|| triangles.clone())
}

impl GoldenComparison {
    fn record_metric(&mut self, metric: Metric, value: f64, place: impl FnOnce() -> String) {
        self.numbers.insert(metric, value);
        if value > 0.0 {
            self.places.insert(metric, place());
        }
    }

    fn measure_displacements(&mut self, found: &CaseResult, unit: f64) {
        let far: Vec<f64> = found
            .positions
            .iter()
            .zip(&self.stored)
            .map(|(p, q)| p.distance(*q))
            .collect();
        let count = far.len().max(1) as f64;
        let mut order: Vec<u32> = (0..far.len() as u32).filter(|&v| far[v as usize] > 0.0).collect();
        order.sort_by(|&a, &b| far[b as usize].total_cmp(&far[a as usize]).then(a.cmp(&b)));
        for v in order {
            let p = found.positions[v as usize];
            if self
                .worst
                .iter()
                .all(|&w| found.positions[w as usize].distance(p) > APART * unit)
            {
                self.worst.push(v);
            }
            if self.worst.len() == WORST {
                break;
            }
        }
        let most = far.iter().copied().fold(0.0, f64::max);
        let worst = self.worst.first().copied().unwrap_or_default();
        let at = found.positions.get(worst as usize).copied().unwrap_or_default();
        self.record_metric(Metric::MaxDisplacement, most / unit, || {
            format!("vertex {worst} at {}", format_point(at))
        });
        let mean = far.iter().sum::<f64>() / count;
        let squares = far.iter().map(|d| d * d).sum::<f64>() / count;
        self.numbers.insert(Metric::MeanDisplacement, mean / unit);
        self.numbers.insert(Metric::RmsDisplacement, squares.sqrt() / unit);
    }

    fn measure_normals(&mut self, found: &CaseResult, pool: &Pool) {
        let normal = |shape: &[DVec3], t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| shape[v as usize]);
            (b - a).cross(c - a)
        };
        // Degrees by triangle; what had no area and has none still is not turned.
        let angles: Vec<f64> = pool.install(|| {
            let angle = |t: &[u32; 3]| {
                let (now, stored) = (normal(&found.positions, t), normal(&self.stored, t));
                match (now == DVec3::ZERO, stored == DVec3::ZERO) {
                    (true, true) => 0.0,
                    (false, false) => libm::atan2(now.cross(stored).length(), now.dot(stored)).to_degrees(),
                    _ => 90.0,
                }
            };
            found.triangles.par_iter().map(angle).collect()
        });
        let first_worst = |angles: &[f64]| {
            let worst = (0..angles.len()).fold(0, |w, t| if angles[t] > angles[w] { t } else { w });
            format!("triangle {worst}")
        };
        let mut sorted = angles.clone();
        sorted.sort_by(f64::total_cmp);
        self.largest_angle = sorted.last().copied().unwrap_or_default();
        let rank = (sorted.len() * 95).div_ceil(100).saturating_sub(1);
        let percentile = sorted.get(rank).copied().unwrap_or_default();
        self.record_metric(Metric::NormalDegrees, percentile, || first_worst(&angles));
        let flipped: Vec<usize> = (0..angles.len()).filter(|&t| angles[t] > 90.0).collect();
        self.record_metric(Metric::FlippedTriangles, flipped.len() as f64, || {
            let some: Vec<String> = flipped.iter().take(4).map(ToString::to_string).collect();
            let more = if flipped.len() > 4 { " …" } else { "" };
            format!("triangle {}{more}", some.join(", "))
        });
    }

    /// `resolution` is the largest error of a stored position. Edges count as at least twice that long.
    fn measure_edges(&mut self, found: &CaseResult, resolution: f64, pool: &Pool) {
        let change = |a: u32, b: u32| {
            let length = |shape: &[DVec3]| shape[a as usize].distance(shape[b as usize]);
            let (now, stored) = (length(&found.positions), length(&self.stored));
            let base = stored.max(2.0 * resolution);
            if base > 0.0 { (now - stored).abs() / base } else { 0.0 }
        };
        let changes: Vec<[f64; 3]> = pool.install(|| {
            let of = |t: &[u32; 3]| [change(t[0], t[1]), change(t[1], t[2]), change(t[2], t[0])];
            found.triangles.par_iter().map(of).collect()
        });
        let (mut most, mut edge) = (0.0, [0, 0]);
        for (t, changes) in found.triangles.iter().zip(&changes) {
            for k in 0..3 {
                if changes[k] > most {
                    (most, edge) = (changes[k], [t[k], t[(k + 1) % 3]]);
                }
            }
        }
        self.record_metric(Metric::EdgeStretch, most, || format!("edge {} to {}", edge[0], edge[1]));
    }
}

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
/// let distance = hausdorff_distance(&low, &[[0, 1, 2]], &high, &[[0, 1, 2]], &Pool::new(1)?);
/// assert_eq!(distance.map(|(length, _)| length), Some(0.5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Panics
/// When a triangle names a position that does not exist.
pub fn hausdorff_distance(
    a: &[DVec3],
    a_triangles: &[[u32; 3]],
    b: &[DVec3],
    b_triangles: &[[u32; 3]],
    pool: &Pool,
) -> Option<(f64, DVec3)> {
    let one = farthest(a, a_triangles, &TriangleBvh::build(b, b_triangles, pool), pool)?;
    let other = farthest(b, b_triangles, &TriangleBvh::build(a, a_triangles, pool), pool)?;
    Some(if other.0 > one.0 { other } else { one })
}

/// The point of a surface that is farthest from the triangles of `tree`; the first of several.
fn farthest(positions: &[DVec3], triangles: &[[u32; 3]], tree: &TriangleBvh<'_>, pool: &Pool) -> Option<(f64, DVec3)> {
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
    use super::super::golden::InputHashes;
    use super::*;
    use crate::asset::shapes;

    fn found() -> CaseResult {
        let (positions, triangles) = shapes::grid(2.0, 1.0, [20, 10]);
        CaseResult {
            before: (positions.clone(), triangles.clone()),
            positions,
            triangles,
            ..Default::default()
        }
    }

    fn golden(found: &CaseResult) -> Golden {
        Golden::from_result(found, InputHashes::default())
    }

    fn measured(now: &CaseResult, stored: &CaseResult) -> GoldenComparison {
        let one = compare_with_golden(now, &golden(stored), &Pool::new(1).expect("a thread"));
        let two = compare_with_golden(now, &golden(stored), &Pool::new(2).expect("threads"));
        assert_eq!(
            (&one.numbers, &one.places, &one.worst),
            (&two.numbers, &two.places, &two.worst)
        );
        one
    }

    #[test]
    fn the_stored_shape_itself_is_no_distance_away() {
        let comparison = measured(&found(), &found());
        assert!(
            comparison.numbers.values().all(|&x| x == 0.0),
            "{:?}",
            comparison.numbers
        );
        assert!(comparison.places.is_empty() && comparison.worst.is_empty());
        assert_eq!(comparison.numbers.len(), 7);
        // Rounding to 32 bits on the way is none either.
        let mut rounded = found();
        rounded.positions.iter_mut().for_each(|p| *p = p.as_vec3().as_dvec3());
        rounded.rounded = true;
        assert!(measured(&rounded, &found()).numbers.values().all(|&x| x == 0.0));
    }

    #[test]
    fn one_vertex_moved_is_found_with_its_place() {
        let stored = found();
        let mut now = found();
        now.positions[100] += DVec3::new(0.0, 0.0, 1e-3).with_y(1e-3);
        let comparison = measured(&now, &stored);
        let number = |m: Metric| comparison.numbers[&m];
        let diagonal = 5f64.sqrt();
        assert!((number(Metric::MaxDisplacement) - 2f64.sqrt() * 1e-3 / diagonal).abs() < 2e-5);
        assert!(number(Metric::MeanDisplacement) < number(Metric::RmsDisplacement));
        assert!(number(Metric::RmsDisplacement) < number(Metric::MaxDisplacement));
        assert!(number(Metric::Hausdorff) > 0.0 && number(Metric::Hausdorff) <= number(Metric::MaxDisplacement));
        assert_eq!(number(Metric::NormalDegrees), 0.0, "six triangles of four hundred");
        assert!(comparison.largest_angle > 0.1);
        assert!(comparison.places[&Metric::MaxDisplacement].contains("vertex 100"));
        assert_eq!(comparison.worst, [100]);
    }

    #[test]
    fn a_triangle_that_turned_over_is_counted_and_named() {
        let mut now = found();
        // An inner vertex pulled over its neighbour.
        let inner = 5 * 21 + 10;
        let towards = now.positions[inner + 1] - now.positions[inner];
        now.positions[inner] += towards * 1.5;
        let comparison = measured(&now, &found());
        assert!(comparison.numbers[&Metric::FlippedTriangles] >= 1.0);
        assert!(comparison.places[&Metric::FlippedTriangles].starts_with("triangle "));
        assert!(comparison.numbers[&Metric::EdgeStretch] > 0.5);
    }

    #[test]
    fn other_triangles_leave_the_distance_of_the_surfaces() {
        let (positions, triangles) = shapes::grid(2.0, 1.0, [30, 7]);
        let finer = CaseResult {
            before: found().before,
            positions,
            triangles,
            ..Default::default()
        };
        let comparison = measured(&finer, &found());
        assert_eq!(comparison.numbers.keys().collect::<Vec<_>>(), [&Metric::Hausdorff]);
        assert!(comparison.numbers[&Metric::Hausdorff] < 1e-4);
        // Nor can that be reported without the stored triangles.
        let lost = CaseResult {
            before: Default::default(),
            ..finer
        };
        assert!(measured(&lost, &found()).numbers.is_empty());
    }

    fn pool() -> Pool {
        Pool::new(2).expect("threads")
    }

    fn of(a: &shapes::Shape, b: &shapes::Shape) -> f64 {
        hausdorff_distance(&a.0, &a.1, &b.0, &b.1, &pool()).expect("surfaces").0
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
        assert_eq!(hausdorff_distance(&ball.0, &[], &ball.0, &ball.1, &pool()), None);
    }
}
