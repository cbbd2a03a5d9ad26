//! Which boundary points of two parts lie close together.

use crate::mesh::BoundingBox;
use crate::progress::{Cancelled, Progress, check};
use glam::DVec3;
use std::collections::BTreeSet;

/// How often a point whose nearest was taken looks for another.
const ROUNDS: usize = 8;
/// Points compared between two looks at the progress: about a millisecond.
const COMPARED: usize = 1 << 16;

/// Pairs of a point of `from` and one of `to` no further apart than `tolerance`, each point in one pair at most, the
/// closest first.
///
/// A tolerance as long as both are compares each with each, so the progress is asked on the way.
pub(super) fn find_close_pairs(
    from: &[u32],
    to: &[u32],
    tolerance: f64,
    at: impl Fn(u32) -> DVec3,
    progress: &dyn Progress,
) -> Result<Vec<(u32, u32)>, Cancelled> {
    // Sorted along the axis in which they are spread most, so that a rim in a plane does not fall together.
    let places: Vec<DVec3> = to.iter().map(|&p| at(p)).collect();
    let size = BoundingBox::of(&places).size();
    let axis = (0..3).max_by(|&i, &j| size[i].total_cmp(&size[j])).unwrap_or(0);
    let mut order: Vec<(f64, u32)> = to.iter().map(|&p| (at(p)[axis], p)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut free_from: Vec<u32> = from.to_vec();
    let mut taken = BTreeSet::new();
    let mut chosen: Vec<(f64, u32, u32)> = Vec::new();
    let mut since_check = 0;
    // Who finds its nearest taken looks again in the next round.
    for _ in 0..ROUNDS {
        let mut pairs: Vec<(f64, u32, u32)> = Vec::new();
        for &p in &free_from {
            let (near, compared) = find_nearest(at(p), axis, &order, tolerance, &at, &taken);
            since_check += compared + 1;
            if since_check > COMPARED {
                since_check = 0;
                check(progress)?;
            }
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
    Ok(chosen.into_iter().map(|(_, p, q)| (p, q)).collect())
}

/// The nearest point to `x` of those sorted along `axis`, within `tolerance` and not taken; and how many were compared.
fn find_nearest(
    x: DVec3,
    axis: usize,
    order: &[(f64, u32)],
    tolerance: f64,
    at: impl Fn(u32) -> DVec3,
    taken: &BTreeSet<u32>,
) -> (Option<(f64, u32)>, usize) {
    let middle = order.partition_point(|o| o.0 < x[axis]);
    let mut best: Option<(f64, u32)> = None;
    let mut compared = 0;
    let mut look = |o: &(f64, u32)| {
        compared += 1;
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
    (best, compared)
}

/// The closest two points of both, or of a sample of both, with their distance. Neither is empty.
pub(super) fn find_closest(from: &[u32], to: &[u32], at: impl Fn(u32) -> DVec3) -> (f64, u32, u32) {
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
    use crate::progress::{CancelFlag, Silent};

    #[test]
    fn a_comparison_of_each_with_each_ends_when_nobody_wants_it() {
        let flag = CancelFlag::default();
        flag.cancel();
        let (from, to): (Vec<u32>, Vec<u32>) = ((0..1000).collect(), (1000..2000).collect());
        let at = |p: u32| DVec3::X * f64::from(p % 10);
        assert_eq!(find_close_pairs(&from, &to, 100.0, at, &flag), Err(Cancelled));
    }

    #[test]
    fn pairs_are_one_to_one_and_closest_first() {
        let x = [0.0, 1.0, 2.0, 0.1, 0.2, 1.9];
        let at = |p: u32| DVec3::X * x[p as usize];
        let pairs = find_close_pairs(&[3, 4, 5], &[0, 1, 2], 0.25, at, &Silent);
        assert_eq!(pairs, Ok(vec![(3, 0), (5, 2)]));
        assert_eq!(find_closest(&[3, 4], &[1, 2], at), (0.8, 4, 1));
    }
}
