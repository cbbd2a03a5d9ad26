//! The closest point of one segment or one triangle.
//!
//! The triangle has three forms. Two of them differ in rounding only; results of edits keep the form that they were
//! first computed with, so that they are bit-identical.
//!
//! Nearest of a set of points, by a balanced k-d tree without pointers.

use crate::query::visits::VisitCount;
use glam::DVec3;

/// Finds where between `a` and `b` the point closest to `p` lies: 0 at `a`, 1 at `b`, and 0 when both are one point.
pub fn closest_parameter_on_segment(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let along = b - a;
    let t = (p - a).dot(along) / along.length_squared();
    if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) }
}

/// Finds the point of the segment from `a` to `b` that is closest to `p`.
///
/// ```
/// use glam::DVec3;
/// use pliant_mesh::query::closest_point::closest_point_on_segment;
///
/// let above = DVec3::new(0.25, 2.0, 0.0);
/// assert_eq!(closest_point_on_segment(above, DVec3::ZERO, DVec3::X), DVec3::new(0.25, 0.0, 0.0));
/// ```
pub fn closest_point_on_segment(p: DVec3, a: DVec3, b: DVec3) -> DVec3 {
    let t = closest_parameter_on_segment(p, a, b);
    if t > 0.0 { a + (b - a) * t } else { a }
}

/// Finds the point of a triangle that is closest to `p`, by the region of the plane that its foot lies in (Ericson 2005).
/// A face without area is its edges.
///
/// ```
/// use glam::DVec3;
/// use pliant_mesh::query::closest_point::closest_point_on_triangle;
///
/// let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// let above = DVec3::new(0.25, 0.25, 3.0);
/// assert_eq!(closest_point_on_triangle(above, triangle), DVec3::new(0.25, 0.25, 0.0));
/// ```
pub fn closest_point_on_triangle(p: DVec3, corners: [DVec3; 3]) -> DVec3 {
    PreparedTriangle::new(corners).closest_point(p)
}

/// A triangle prepared for many queries.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PreparedTriangle {
    corners: [DVec3; 3],
    ab: DVec3,
    ac: DVec3,
    d11: f64,
    d12: f64,
    d22: f64,
}

impl PreparedTriangle {
    /// Computes what does not depend on the place.
    #[inline]
    pub(crate) fn new([a, b, c]: [DVec3; 3]) -> Self {
        let (ab, ac) = (b - a, c - a);
        Self {
            corners: [a, b, c],
            ab,
            ac,
            d11: ab.length_squared(),
            d12: ab.dot(ac),
            d22: ac.length_squared(),
        }
    }

    /// As [`closest_point_on_triangle`].
    #[inline]
    pub(crate) fn closest_point(&self, p: DVec3) -> DVec3 {
        let Self {
            corners: [a, b, c],
            ab,
            ac,
            d11,
            d12,
            d22,
        } = *self;
        // Thin faces lose their regions to rounding; the nearest point of their edges is as good.
        if d11 * d22 - d12 * d12 <= d11 * d22 * 1e-12 {
            return closest_point_on_sides(p, [a, b, c]);
        }
        let ap = p - a;
        let (a1, a2) = (ab.dot(ap), ac.dot(ap));
        if a1 <= 0.0 && a2 <= 0.0 {
            return a;
        }
        let (b1, b2) = (a1 - d11, a2 - d12);
        if b1 >= 0.0 && b2 <= b1 {
            return b;
        }
        let over_c = a1 * b2 - b1 * a2;
        if over_c <= 0.0 && a1 >= 0.0 && b1 <= 0.0 {
            return a + ab * (a1 / d11);
        }
        let (c1, c2) = (a1 - d12, a2 - d22);
        if c2 >= 0.0 && c1 <= c2 {
            return c;
        }
        let over_b = c1 * a2 - a1 * c2;
        if over_b <= 0.0 && a2 >= 0.0 && c2 <= 0.0 {
            return a + ac * (a2 / d22);
        }
        let over_a = b1 * c2 - c1 * b2;
        if over_a <= 0.0 && b2 >= b1 && c1 >= c2 {
            return b + (c - b) * ((b2 - b1) / ((b2 - b1) + (c1 - c2)));
        }
        let scale = 1.0 / (over_a + over_b + over_c);
        a + ab * (over_b * scale) + ac * (over_c * scale)
    }
}

/// Finds the point of a triangle's three sides that is closest to `p`; of equally close ones that on the first side.
fn closest_point_on_sides(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let closer = |x: DVec3, y: DVec3| {
        if y.distance_squared(p) < x.distance_squared(p) {
            y
        } else {
            x
        }
    };
    closer(
        closer(closest_point_on_segment(p, a, b), closest_point_on_segment(p, b, c)),
        closest_point_on_segment(p, c, a),
    )
}

/// Finds the point of a triangle that is closest to `p` as weights of the corners (not negative, sum 1), and its squared
/// distance. The weights are finite for a triangle without area too.
pub fn closest_weights_on_triangle(p: DVec3, t: [DVec3; 3]) -> ([f64; 3], f64) {
    let n = (t[1] - t[0]).cross(t[2] - t[0]);
    let doubled = n.length_squared();
    if doubled > 0.0 && doubled.is_finite() {
        // Twice the signed areas that the foot of p makes with each side, relative to the triangle's own.
        let part = |i: usize| (t[(i + 2) % 3] - t[(i + 1) % 3]).cross(p - t[(i + 1) % 3]).dot(n) / doubled;
        let w = [part(0), part(1), part(2)];
        let sum = w[0] + w[1] + w[2];
        if w.iter().all(|&w| w >= 0.0) && sum > 0.0 {
            let w = w.map(|w| w / sum);
            return (w, blend_corners(t, w).distance_squared(p));
        }
    }
    let mut best = ([1.0, 0.0, 0.0], f64::INFINITY);
    for i in 0..3 {
        let j = (i + 1) % 3;
        let s = closest_parameter_on_segment(p, t[i], t[j]);
        let d = (t[i] + (t[j] - t[i]) * s).distance_squared(p);
        if d < best.1 {
            let mut w = [0.0; 3];
            (w[i], w[j]) = (1.0 - s, s);
            best = (w, d);
        }
    }
    best
}

/// Blends the corners of a triangle with weights.
pub fn blend_corners(t: [DVec3; 3], w: [f64; 3]) -> DVec3 {
    t[0] * w[0] + t[1] * w[1] + t[2] * w[2]
}

/// Computes the barycentric coordinates of `p`, or of its foot in the triangle's plane. They are not finite for a triangle
/// without area.
pub fn barycentric_coordinates([a, b, c]: [DVec3; 3], p: DVec3) -> [f64; 3] {
    let normal = (b - a).cross(c - a);
    let whole = normal.length_squared();
    let part = |q: DVec3, r: DVec3| (q - p).cross(r - p).dot(normal) / whole;
    let (first, second) = (part(b, c), part(c, a));
    [first, second, 1.0 - first - second]
}

/// Finds the point of a triangle that is closest to `p` by its barycentric coordinates. It differs from
/// [`closest_point_on_triangle`] in rounding only.
pub fn closest_barycentric_point(p: DVec3, t: [DVec3; 3]) -> DVec3 {
    let coordinates = barycentric_coordinates(t, p);
    if coordinates.iter().all(|&s| s >= 0.0) {
        blend_corners(t, coordinates)
    } else {
        closest_point_on_sides(p, t)
    }
}

/// A set of points that can be asked which of them is nearest to a place.
#[derive(Debug, Clone)]
pub struct NearestPoints {
    /// Points in tree order: the median of every range stands in its middle.
    points: Vec<(DVec3, u32)>,
    /// What long queries have looked at.
    pub visits: VisitCount,
}

impl NearestPoints {
    /// Takes points with the numbers to be returned.
    pub fn new(points: impl IntoIterator<Item = (DVec3, u32)>) -> Self {
        let mut points: Vec<_> = points.into_iter().collect();
        let mut ranges = vec![(0, points.len())];
        while let Some((from, to)) = ranges.pop() {
            if to - from < 2 {
                continue;
            }
            let axis = split_axis(to - from);
            let middle = from + (to - from) / 2;
            points[from..to].select_nth_unstable_by(middle - from, |a, b| {
                a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
            });
            ranges.push((from, middle));
            ranges.push((middle + 1, to));
        }
        Self {
            points,
            visits: VisitCount::default(),
        }
    }

    /// The number of the nearest point and its squared distance; ties go to the smaller number. `None` without points.
    pub fn nearest(&self, place: DVec3) -> Option<(u32, f64)> {
        self.nearest_within(place, f64::INFINITY)
    }

    /// As [`NearestPoints::nearest`], for points whose squared distance is at most `square`; a small one makes the search faster.
    pub fn nearest_within(&self, place: DVec3, square: f64) -> Option<(u32, f64)> {
        let mut best: Option<(u32, f64)> = None;
        // (range, squared distance below which nothing in it can be nearer). Each range taken puts back two of half its
        // length, so there are never more than twice as many as the number of points has digits.
        let mut stack = [(0usize, 0usize, 0.0f64); 2 * usize::BITS as usize];
        stack[0].1 = self.points.len();
        let (mut waiting, mut visits) = (1, 0);
        while waiting > 0 {
            (waiting, visits) = (waiting - 1, visits + 1);
            let (from, to, bound) = stack[waiting];
            if from >= to || bound > best.map_or(square, |b| b.1) {
                continue;
            }
            let axis = split_axis(to - from);
            let middle = from + (to - from) / 2;
            let (point, number) = self.points[middle];
            let distance = point.distance_squared(place);
            let is_better = |(n, d)| distance < d || (distance == d && number < n);
            if best.map_or(distance <= square, is_better) {
                best = Some((number, distance));
            }
            let ahead = place[axis] - point[axis];
            let far = ahead * ahead;
            let halves = [(from, middle), (middle + 1, to)];
            let [near, other] = if ahead < 0.0 { halves } else { [halves[1], halves[0]] };
            // The half that the place lies in goes on top.
            stack[waiting] = (other.0, other.1, far.max(bound));
            stack[waiting + 1] = (near.0, near.1, bound);
            waiting += 2;
        }
        self.visits.add(visits);
        best
    }
}

/// Axes take turns with the size of the range, which building and asking both know.
fn split_axis(len: usize) -> usize {
    (usize::BITS - len.leading_zeros()) as usize % 3
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIGHT_TRIANGLE: [DVec3; 3] = [DVec3::ZERO, DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 3.0, 0.0)];

    #[test]
    fn nearest_points_are_right_on_faces_edges_corners_and_needles() {
        let t = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let cases = [
            ([0.2, 0.2, 3.0], [0.2, 0.2, 0.0]),
            ([0.4, -1.0, 0.0], [0.4, 0.0, 0.0]),
            ([2.0, -1.0, 1.0], [1.0, 0.0, 0.0]),
            ([1.0, 1.0, 0.0], [0.5, 0.5, 0.0]),
        ];
        for (p, expected) in cases {
            for closest in [closest_point_on_triangle, closest_barycentric_point] {
                let found = closest(DVec3::from_array(p), t);
                assert!(found.distance(DVec3::from_array(expected)) < 1e-12, "{p:?} to {found}");
            }
        }
        let needle = [DVec3::ZERO, DVec3::X, DVec3::X * 0.5];
        assert_eq!(
            closest_point_on_triangle(DVec3::new(0.3, 1.0, 0.0), needle),
            DVec3::new(0.3, 0.0, 0.0)
        );
        assert_eq!(closest_point_on_triangle(DVec3::Y, [DVec3::ZERO; 3]), DVec3::ZERO);
    }

    #[test]
    fn the_closest_weights_beat_a_fine_search() {
        for q in [
            DVec3::new(1.0, 1.0, 2.0),
            DVec3::new(-1.0, -1.0, 0.5),
            DVec3::new(5.0, 5.0, 0.0),
            DVec3::new(2.0, -3.0, 1.0),
            DVec3::new(-2.0, 9.0, -1.0),
        ] {
            let (w, d) = closest_weights_on_triangle(q, RIGHT_TRIANGLE);
            assert!(w.iter().all(|w| (0.0..=1.0).contains(w)) && (w.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!((blend_corners(RIGHT_TRIANGLE, w).distance_squared(q) - d).abs() < 1e-9);
            assert!((closest_point_on_triangle(q, RIGHT_TRIANGLE).distance_squared(q) - d).abs() < 1e-9);
            for i in 0..=40 {
                for j in 0..=40 - i {
                    let v = [i as f64 / 40.0, j as f64 / 40.0, (40 - i - j) as f64 / 40.0];
                    let there = blend_corners(RIGHT_TRIANGLE, v).distance_squared(q);
                    assert!(there >= d - 1e-12, "{q} at {v:?}");
                }
            }
        }
        let (w, _) = closest_weights_on_triangle(DVec3::ONE, [DVec3::ZERO; 3]);
        assert!(w.iter().all(|w| w.is_finite()));
    }
}

#[cfg(test)]
mod nearest_points_tests {
    use super::*;

    #[test]
    fn agrees_with_looking_at_every_point() {
        let mut random = crate::testing::random(1);
        let points: Vec<_> = (0..500)
            .map(|k| (DVec3::new(random(), random() * 0.1, random()), k))
            .collect();
        let tree = NearestPoints::new(points.iter().copied());
        for _ in 0..200 {
            let place = DVec3::new(random() * 2.0, random(), random());
            let expected = points
                .iter()
                .map(|p| (p.0.distance_squared(place), p.1))
                .min_by(|a, b| a.partial_cmp(b).unwrap());
            assert_eq!(tree.nearest(place).map(|(n, d)| (d, n)), expected);
            let square = 0.01 * random();
            let within = expected.filter(|e| e.0 <= square);
            assert_eq!(tree.nearest_within(place, square).map(|(n, d)| (d, n)), within);
        }
        assert_eq!(NearestPoints::new([]).nearest(DVec3::ZERO), None);
    }
}
