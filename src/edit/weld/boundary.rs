//! The points on the rim of a surface, and which of two rims lie close together.

use crate::edit::Surface;
use crate::mesh::{BoundingBox, NONE};
use glam::DVec3;
use std::collections::BTreeSet;

/// How often a point whose nearest was taken looks for another.
const ROUNDS: usize = 8;

/// The points where an edge has more faces on one side than on the other, rising.
///
/// One flat scan: over the faces around a point of the inside, each neighbour comes once after it and once before it,
/// so that sums of scrambled numbers cancel. That they cancel by chance is as good as impossible.
pub(in crate::edit) fn rim_points(surface: &Surface) -> Vec<u32> {
    let mut sums = vec![0u64; surface.points as usize];
    for t in surface.triangles {
        let p = t.map(|v| surface.point_of[v as usize]);
        if p.contains(&NONE) || p[0] == p[1] || p[1] == p[2] || p[2] == p[0] {
            continue;
        }
        for i in 0..3 {
            let sum = &mut sums[p[i] as usize];
            *sum = sum
                .wrapping_add(scramble(p[(i + 1) % 3]))
                .wrapping_sub(scramble(p[(i + 2) % 3]));
        }
    }
    sums.iter()
        .zip(0u32..)
        .filter(|(s, _)| **s != 0)
        .map(|(_, p)| p)
        .collect()
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
fn scramble(p: u32) -> u64 {
    let mut x = u64::from(p).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Pairs of a point of `from` and one of `to` no further apart than `tolerance`, each point in one pair at most, the
/// closest first.
pub(super) fn close_pairs(from: &[u32], to: &[u32], tolerance: f64, at: impl Fn(u32) -> DVec3) -> Vec<(u32, u32)> {
    // Sorted along the axis in which they are spread most, so that a rim in a plane does not fall together.
    let places: Vec<DVec3> = to.iter().map(|&p| at(p)).collect();
    let size = BoundingBox::of(&places).size();
    let axis = (0..3).max_by(|&i, &j| size[i].total_cmp(&size[j])).unwrap_or(0);
    let mut order: Vec<(f64, u32)> = to.iter().map(|&p| (at(p)[axis], p)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut free_from: Vec<u32> = from.to_vec();
    let mut taken = BTreeSet::new();
    let mut chosen: Vec<(f64, u32, u32)> = Vec::new();
    // Who finds its nearest taken looks again in the next round.
    for _ in 0..ROUNDS {
        let mut pairs: Vec<(f64, u32, u32)> = Vec::new();
        for &p in &free_from {
            let near = nearest(at(p), axis, &order, tolerance, &at, &taken);
            pairs.extend(near.map(|(distance, q)| (distance, p, q)));
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        if pairs.is_empty() {
            break;
        }
        for pair in pairs {
            if taken.insert(pair.2) {
                chosen.push(pair);
            }
        }
        let mut done: Vec<u32> = chosen.iter().map(|c| c.1).collect();
        done.sort_unstable();
        free_from.retain(|p| done.binary_search(p).is_err());
    }
    chosen.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    chosen.into_iter().map(|(_, p, q)| (p, q)).collect()
}

/// The nearest point to `x` of those sorted along `axis`, within `tolerance` and not taken.
fn nearest(
    x: DVec3,
    axis: usize,
    order: &[(f64, u32)],
    tolerance: f64,
    at: impl Fn(u32) -> DVec3,
    taken: &BTreeSet<u32>,
) -> Option<(f64, u32)> {
    let middle = order.partition_point(|o| o.0 < x[axis]);
    let mut best: Option<(f64, u32)> = None;
    let mut look = |o: &(f64, u32)| {
        let reach = best.map_or(tolerance, |b| b.0);
        if (o.0 - x[axis]).abs() > reach {
            return false;
        }
        let distance = x.distance(at(o.1));
        if distance <= reach && best.is_none_or(|b| (distance, o.1) < b) && !taken.contains(&o.1) {
            best = Some((distance, o.1));
        }
        true
    };
    order[..middle].iter().rev().all(&mut look);
    order[middle..].iter().all(&mut look);
    best
}

/// The closest two points of both, or of a sample of both, with their distance. Neither is empty.
pub(super) fn closest(from: &[u32], to: &[u32], at: impl Fn(u32) -> DVec3) -> (f64, u32, u32) {
    const SAMPLE: usize = 2000;
    let mut best = (f64::INFINITY, from[0], to[0]);
    for &p in from.iter().step_by(from.len().div_ceil(SAMPLE)) {
        for &q in to.iter().step_by(to.len().div_ceil(SAMPLE)) {
            let distance = at(p).distance(at(q));
            if distance < best.0 {
                best = (distance, p, q);
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rim_of_an_open_box_is_found_and_a_closed_one_has_none() {
        let triangles = [[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let surface = |count: usize| Surface {
            positions: &positions,
            triangles: &triangles[..count],
            primitive_of: &[0; 4][..count],
            point_of: &[0, 1, 2, 3],
            points: 4,
        };
        assert!(rim_points(&surface(4)).is_empty());
        assert_eq!(rim_points(&surface(3)), [0, 2, 3]);
    }

    #[test]
    fn pairs_are_one_to_one_and_closest_first() {
        let x = [0.0, 1.0, 2.0, 0.1, 0.2, 1.9];
        let at = |p: u32| DVec3::X * x[p as usize];
        assert_eq!(close_pairs(&[3, 4, 5], &[0, 1, 2], 0.25, at), [(3, 0), (5, 2)]);
        assert_eq!(closest(&[3, 4], &[1, 2], at), (0.8, 4, 1));
    }
}
