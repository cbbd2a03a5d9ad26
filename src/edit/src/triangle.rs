//! Measures of one triangle.

use glam::DVec3;

/// Twice the area, along the normal.
pub(super) fn area_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The length of the longest side.
pub(super) fn longest_side([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance(b).max(b.distance(c)).max(c.distance(a))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aspect_is_one_for_equilateral_and_infinite_without_area() {
        let regular = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.75f64.sqrt(), 0.0)];
        assert!((aspect(regular) - 1.0).abs() < 1e-12);
        assert_eq!(aspect([DVec3::ZERO, DVec3::X, DVec3::X * 2.0]), f64::INFINITY);
        assert_eq!(aspect([DVec3::ZERO; 3]), f64::INFINITY);
    }
}
