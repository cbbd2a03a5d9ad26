//! Exact predicates in the plane (Shewchuk's adaptive ones) and measures of loops in it.

use glam::DVec2;
use robust::Coord;

pub(super) fn coord(p: DVec2) -> Coord<f64> {
    Coord { x: p.x, y: p.y }
}

/// Positive when `a`, `b`, `c` turn left; the sign is exact.
pub(super) fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    robust::orient2d(coord(a), coord(b), coord(c))
}

/// Twice the signed area of a loop.
pub(in crate::edit) fn double_area(at: impl Fn(u32) -> DVec2, ring: &[u32]) -> f64 {
    let Some(&first) = ring.first() else {
        return 0.0;
    };
    let base = at(first);
    let ends = ring.iter().zip(ring.iter().cycle().skip(1));
    ends.map(|(&a, &b)| (at(a) - base).perp_dot(at(b) - base)).sum()
}

/// Whether `p` lies inside a loop (by crossings), or `None` when it lies on it.
pub(in crate::edit) fn loop_contains(at: impl Fn(u32) -> DVec2, ring: &[u32], p: DVec2) -> Option<bool> {
    let mut inside = false;
    for (&a, &b) in ring.iter().zip(ring.iter().cycle().skip(1)) {
        let (a, b) = (at(a), at(b));
        let side = turn(a, b, p);
        let between = p.cmpge(a.min(b)).all() && p.cmple(a.max(b)).all();
        if side == 0.0 && between {
            return None;
        }
        if (a.y <= p.y) != (b.y <= p.y) && (side > 0.0) == (b.y > a.y) {
            inside = !inside;
        }
    }
    Some(inside)
}
