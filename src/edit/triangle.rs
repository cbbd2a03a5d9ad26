//! Measures of one triangle.

use glam::DVec3;

/// Twice the area, along the normal.
pub(super) fn area_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// How far from equilateral: longest side times perimeter over 4·√3 times the area. 1 at best, infinite for a triangle
/// without area.
pub(super) fn aspect([a, b, c]: [DVec3; 3]) -> f64 {
    let sides = [a.distance(b), b.distance(c), c.distance(a)];
    let longest = sides[0].max(sides[1]).max(sides[2]);
    let area = 0.5 * area_normal([a, b, c]).length();
    let value = longest * (sides[0] + sides[1] + sides[2]) / (4.0 * 3f64.sqrt() * area);
    if value.is_finite() { value } else { f64::INFINITY }
}

/// Area over the sum of squared edges: 0 for a sliver, largest for an equilateral triangle.
pub(super) fn evenness([a, b, c]: [DVec3; 3]) -> f64 {
    let squares = (b - a).length_squared() + (c - b).length_squared() + (a - c).length_squared();
    if squares > 0.0 {
        (b - a).cross(c - a).length() / squares
    } else {
        0.0
    }
}

/// The cosine of the angle between two vectors; `None` when one is zero or not finite.
pub(super) fn cosine(a: DVec3, b: DVec3) -> Option<f64> {
    Some(a.try_normalize()?.dot(b.try_normalize()?))
}

/// Whether a triangle that changes keeps an area and turns by no more than the angle with cosine `least`. One that had
/// no area may get any.
pub(super) fn turns_little(before: [DVec3; 3], after: [DVec3; 3], least: f64) -> bool {
    let (n, m) = (area_normal(before), area_normal(after));
    match cosine(n, m) {
        Some(cosine) => cosine >= least,
        None => n.try_normalize().is_none(),
    }
}

/// The point of a triangle nearest to `p`, as weights of the corners (not negative, sum 1), and its squared distance.
pub(super) fn nearest(p: DVec3, t: [DVec3; 3]) -> ([f64; 3], f64) {
    let n = area_normal(t);
    let doubled = n.length_squared();
    if doubled > 0.0 && doubled.is_finite() {
        // Twice the signed areas that the foot of p makes with each side, relative to the triangle's own.
        let part = |i: usize| (t[(i + 2) % 3] - t[(i + 1) % 3]).cross(p - t[(i + 1) % 3]).dot(n) / doubled;
        let w = [part(0), part(1), part(2)];
        let sum = w[0] + w[1] + w[2];
        if w.iter().all(|&w| w >= 0.0) && sum > 0.0 {
            let w = w.map(|w| w / sum);
            return (w, at(t, w).distance_squared(p));
        }
    }
    let mut best = ([1.0, 0.0, 0.0], f64::INFINITY);
    for i in 0..3 {
        let j = (i + 1) % 3;
        let (s, d) = nearest_on_segment(p, t[i], t[j]);
        if d < best.1 {
            let mut w = [0.0; 3];
            (w[i], w[j]) = (1.0 - s, s);
            best = (w, d);
        }
    }
    best
}

/// Where on the way from `a` to `b` (0 to 1) the point nearest to `p` lies, and its squared distance.
pub(super) fn nearest_on_segment(p: DVec3, a: DVec3, b: DVec3) -> (f64, f64) {
    let along = b - a;
    let s = (p - a).dot(along) / along.length_squared();
    let s = if s.is_finite() { s.clamp(0.0, 1.0) } else { 0.0 };
    (s, (a + along * s).distance_squared(p))
}

/// The point with weights `w`.
pub(super) fn at(t: [DVec3; 3], w: [f64; 3]) -> DVec3 {
    t[0] * w[0] + t[1] * w[1] + t[2] * w[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: [DVec3; 3] = [DVec3::ZERO, DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 3.0, 0.0)];

    #[test]
    fn aspect_is_one_for_equilateral_and_infinite_without_area() {
        let regular = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.75f64.sqrt(), 0.0)];
        assert!((aspect(regular) - 1.0).abs() < 1e-12);
        assert_eq!(aspect([DVec3::ZERO, DVec3::X, DVec3::X * 2.0]), f64::INFINITY);
        assert_eq!(aspect([DVec3::ZERO; 3]), f64::INFINITY);
    }

    #[test]
    fn the_nearest_point_beats_a_fine_search() {
        for q in [
            DVec3::new(1.0, 1.0, 2.0),
            DVec3::new(-1.0, -1.0, 0.5),
            DVec3::new(5.0, 5.0, 0.0),
            DVec3::new(2.0, -3.0, 1.0),
            DVec3::new(-2.0, 9.0, -1.0),
        ] {
            let (w, d) = nearest(q, T);
            assert!(w.iter().all(|w| (0.0..=1.0).contains(w)) && (w.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!((at(T, w).distance_squared(q) - d).abs() < 1e-9);
            for i in 0..=40 {
                for j in 0..=40 - i {
                    let v = [i as f64 / 40.0, j as f64 / 40.0, (40 - i - j) as f64 / 40.0];
                    assert!(at(T, v).distance_squared(q) >= d - 1e-12, "{q} at {v:?}");
                }
            }
        }
        let (w, _) = nearest(DVec3::ONE, [DVec3::ZERO; 3]);
        assert!(w.iter().all(|w| w.is_finite()));
    }
}
