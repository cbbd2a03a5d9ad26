//! Pairs of triangles that cross, with where and how deep, and whether anything could have kept them apart.

use crate::Mesh;
use crate::intersections::{do_cross, passes, rounded, signed_volume, visit_crossings};
use crate::measure::BoundingBox;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use std::collections::BinaryHeap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Why two triangles cross.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairKind {
    /// The pose brought them together.
    New,
    /// They cross in the rest pose too.
    AtRest,
    /// They do not cross in the rest pose, and all of their corners are held: no deformation of what is free parts them.
    Held,
}

/// Two triangles that cross.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrossingPair {
    /// By their numbers in the model, the smaller one first.
    pub triangles: [u32; 2],
    /// Why they cross.
    pub kind: PairKind,
    /// In the middle of where they meet, in model space.
    pub at: DVec3,
    /// The shortest way, in model units, that one of the two has to go along its own normal or the other's until it lies on one
    /// side of the other's plane or its own.
    pub depth: f64,
}

/// Pairs of triangles that cross, and how many there are of each kind.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CrossingPairs {
    /// The first ones, ascending.
    pub pairs: Vec<CrossingPair>,
    /// How many are [`PairKind::New`].
    pub new: u64,
    /// How many are [`PairKind::AtRest`].
    pub at_rest: u64,
    /// How many are [`PairKind::Held`].
    pub held: u64,
}

impl Mesh {
    /// Lists the pairs of triangles that cross in a shape of the model that the mesh was built of, by the rule of
    /// [`crate::self_intersections`]. `positions` and `rest` are those of the model's vertices; seams are closed as in the mesh.
    /// `is_held` says of a solver vertex that it is held in place. At most `most` pairs are listed, all are counted; the list does
    /// not depend on threads.
    ///
    /// # Errors
    /// [`Cancelled`] when `progress` says so.
    ///
    /// # Panics
    /// When there are fewer positions than the model has.
    pub fn crossing_pairs(
        &self,
        positions: &[DVec3],
        rest: &[DVec3],
        is_held: &(impl Fn(u32) -> bool + Sync),
        most: usize,
        exec: &Exec<'_>,
    ) -> Result<CrossingPairs, Cancelled> {
        let shape = self.welded(positions);
        let (now, before) = (rounded(&shape), rounded(&self.welded(rest)));
        let origin = BoundingBox::of(&shape).origin();
        let corners = |pair: [u32; 2]| pair.map(|t| self.triangles[t as usize]);
        let kind_of = |pair: [u32; 2]| {
            let [a, b] = corners(pair);
            match (do_cross(&before, a, b), a.iter().chain(&b).all(|v| is_held(*v))) {
                (true, _) => PairKind::AtRest,
                (false, true) => PairKind::Held,
                (false, false) => PairKind::New,
            }
        };
        let (new, at_rest, held) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
        // The smallest ones, whichever order they come in: the largest of them leaves for a smaller one.
        let first = Mutex::new(BinaryHeap::<[u32; 2]>::new());
        let note = |pair: [u32; 2]| {
            let count = match kind_of(pair) {
                PairKind::New => &new,
                PairKind::AtRest => &at_rest,
                PairKind::Held => &held,
            };
            count.fetch_add(1, Ordering::Relaxed);
            let mut first = first.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            if first.len() < most {
                first.push(pair);
            } else if let Some(mut last) = first.peek_mut()
                && pair < *last
            {
                *last = pair;
            }
        };
        visit_crossings(&shape, &self.triangles, None, &note, exec)?;
        let first = first.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut pairs: Vec<CrossingPair> = first
            .into_iter()
            .map(|pair| {
                let [a, b] = corners(pair).map(|t| t.map(|v| now[v as usize]));
                let [s, t] = pair.map(|t| self.source_triangle[t as usize]);
                CrossingPair {
                    triangles: [s.min(t), s.max(t)],
                    kind: kind_of(pair),
                    at: origin + meeting(a, b),
                    depth: depth(a, b).min(depth(b, a)),
                }
            })
            .collect();
        pairs.sort_unstable_by_key(|pair| pair.triangles);
        Ok(CrossingPairs {
            pairs,
            new: new.into_inner(),
            at_rest: at_rest.into_inner(),
            held: held.into_inner(),
        })
    }
}

/// The middle of the points in which edges of one triangle pass through the other.
fn meeting(a: [DVec3; 3], b: [DVec3; 3]) -> DVec3 {
    let (mut sum, mut count) = (DVec3::ZERO, 0.0);
    for (own, other) in [(a, b), (b, a)] {
        for k in 0..3 {
            let (p, q) = (own[k], own[(k + 1) % 3]);
            if passes(p, q, other) {
                let height = |point| signed_volume(other[0], other[1], other[2], point);
                let (from, to) = (height(p), height(q));
                sum += p.lerp(q, from / (from - to));
                count += 1.0;
            }
        }
    }
    match count {
        0.0 => (a.iter().sum::<DVec3>() + b.iter().sum::<DVec3>()) / 6.0,
        count => sum / count,
    }
}

/// How far `a` has to go along the normal of `b` until no corner of it lies beyond the plane of `b`, on the nearer side.
fn depth(a: [DVec3; 3], b: [DVec3; 3]) -> f64 {
    let normal = (b[1] - b[0]).cross(b[2] - b[0]).normalize_or_zero();
    let heights = a.map(|p| (p - b[0]).dot(normal));
    let above = heights.iter().fold(0.0, |most: f64, h| most.max(*h));
    let below = heights.iter().fold(0.0, |most: f64, h| most.max(-h));
    above.min(below)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Weld;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    /// Rows of upright triangles, each with the tip `tip` above the ground, through the ground of one large triangle.
    fn spikes(tips: &[f64]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut points: Vec<DVec3> = [[-10.0, -10.0, 0.0], [30.0, -10.0, 0.0], [-10.0, 30.0, 0.0]]
            .map(DVec3::from_array)
            .into();
        let mut triangles = vec![[0, 1, 2]];
        for (k, tip) in tips.iter().enumerate() {
            let (x, y) = ((k % 15) as f64, (k / 15) as f64 * 0.2);
            let first = points.len() as u32;
            points.extend([[x, y, tip - 2.0], [x + 0.5, y, tip - 2.0], [x + 0.25, y, *tip]].map(DVec3::from_array));
            triangles.push([first, first + 1, first + 2]);
        }
        (points, triangles)
    }

    fn pairs(
        now: &[f64],
        rest: &[f64],
        held: &(impl Fn(u32) -> bool + Sync),
        most: usize,
        threads: usize,
    ) -> CrossingPairs {
        let (positions, triangles) = spikes(now);
        let mesh = Mesh::build(&spikes(rest).0, &triangles, Weld::Exact).expect("a mesh");
        let pool = Pool::new(threads).expect("threads");
        let found = mesh.crossing_pairs(&positions, &spikes(rest).0, held, most, &Exec::new(&pool, &Silent));
        found.expect("no cancel")
    }

    #[test]
    fn pairs_have_a_kind_a_place_and_a_depth() {
        let held = |v: u32| v < 3 || (6..9).contains(&v);
        let found = pairs(&[0.25, 0.5, 1.5, -1.0], &[-1.0, -1.0, 1.0, -1.0], &held, 9, 2);
        assert_eq!((found.new, found.at_rest, found.held), (1, 1, 1));
        let kinds: Vec<_> = found.pairs.iter().map(|pair| (pair.triangles, pair.kind)).collect();
        let wanted = [
            ([0, 1], PairKind::New),
            ([0, 2], PairKind::Held),
            ([0, 3], PairKind::AtRest),
        ];
        assert_eq!(kinds, wanted);
        for (pair, (depth, x)) in found.pairs.iter().zip([(0.25, 0.25), (0.5, 1.25), (0.5, 2.25)]) {
            assert!((pair.depth - depth).abs() < 1e-6, "{pair:?}");
            assert!(pair.at.distance(DVec3::new(x, 0.0, 0.0)) < 1e-6, "{pair:?}");
        }
    }

    #[test]
    fn the_first_pairs_are_listed_and_all_counted_for_any_number_of_threads() {
        let (now, rest) = (vec![0.5; 300], vec![-1.0; 300]);
        let all = pairs(&now, &rest, &|_| false, 1000, 1);
        assert_eq!((all.pairs.len(), all.new), (300, 300));
        for threads in [1, 3, 8] {
            let some = pairs(&now, &rest, &|_| false, 7, threads);
            assert_eq!((&some.pairs[..], some.new), (&all.pairs[..7], 300));
        }
    }
}
