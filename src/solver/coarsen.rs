//! Seeds and aggregates: which rows become one row of the next level (paper section 4).

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::lanes::{Lanes, Shared};
use super::level::{Level, NONE};
use super::threads::{Threads, piece, pieces};

/// Rows that one piece of work handles.
const PIECE: usize = 4096;

/// Rows whose edges make the sample for the mean edge length.
const SAMPLE: usize = 4096;

/// A neighbour whose edge weighs less than this part of a row's heaviest edge says too little about the row to stand
/// for it on the next level.
const WEAK: f32 = 0.02;

/// Seeds must leave at most this part of the rows, or the level is paired instead.
const SHRINK: f64 = 0.8;

/// For each row the number of its aggregate, or [`NONE`] for a row without neighbours; and how many there are.
///
/// Aggregates are connected, and at most 80 % as many as there are rows with neighbours.
pub(crate) fn aggregates(level: &Level, ratio: f64, threads: Threads) -> (Vec<u32>, usize) {
    let threads = threads.for_rows(level.rows());
    let connected = (0..level.rows()).filter(|&i| level.connected(i)).count();
    let nearest = nearest_seeds(level, ratio, threads);
    // Seeds are numbered in sweep order.
    let mut numbers = vec![NONE; level.rows()];
    let mut count = 0u32;
    for (i, number) in numbers.iter_mut().enumerate() {
        if nearest[i] == i as u32 {
            *number = count;
            count += 1;
        }
    }
    if f64::from(count) > SHRINK * connected as f64 {
        return pair(level);
    }
    let mut aggregates = nearest;
    let shared = Shared::new(&mut aggregates);
    threads.each(0..pieces(level.rows(), PIECE), |k| {
        // SAFETY: pieces are disjoint and each is visited once.
        for seed in unsafe { shared.rows(piece(k, level.rows(), PIECE)) } {
            if *seed != NONE {
                *seed = numbers[*seed as usize];
            }
        }
    });
    (aggregates, count as usize)
}

#[inline(always)]
fn distance2(a: Lanes, b: Lanes) -> f32 {
    let d = a - b;
    let [x, y, z, _] = (d * d).0;
    x + y + z
}

/// Mean length of the edges of evenly spread rows.
fn mean_edge(level: &Level) -> f64 {
    let n = level.rows();
    let samples = n.min(SAMPLE);
    let (mut total, mut edges) = (0.0, 0usize);
    for s in 0..samples {
        let i = (s as u64 * n as u64 / samples as u64) as usize;
        for (j, _) in level.row(i) {
            total += f64::from(distance2(level.positions[i], level.positions[j])).sqrt();
            edges += 1;
        }
    }
    if edges > 0 { total / edges as f64 } else { 0.0 }
}

/// Largest (squared) distance of neighbours of which only one can be a seed: the paper's δ.
fn reach2(level: &Level, ratio: f64) -> f32 {
    if level.positions.is_empty() {
        return f32::INFINITY;
    }
    let delta = mean_edge(level) * libm::cbrt(1.0 / ratio);
    (delta * delta) as f32
}

/// The paper's maximal δ-independent set, and for every row the seed it joins (a seed itself, [`NONE`] for a row without
/// neighbours).
///
/// In sweep order, a row becomes a seed unless a seed before it is a (not weak) neighbour within δ. Each row joins the
/// adjacent seed with the least (squared distance) / weight, ties to the earlier one. Seeds tell their neighbours of
/// both, so that only the rows of seeds are read. The outcome does not depend on who tells first: a block hears of
/// seeds in blocks of other colours before or after it is swept, never while, and joining takes a minimum.
fn nearest_seeds(level: &Level, ratio: f64, threads: Threads) -> Vec<u32> {
    let n = level.rows();
    let reach2 = reach2(level, ratio);
    let placed = !level.positions.is_empty();
    let weak: Vec<f32> = match &level.weights {
        None => Vec::new(),
        Some(_) => (0..n)
            .map(|i| WEAK * level.row(i).fold(0.0f32, |a, (_, w)| a.max(w)))
            .collect(),
    };
    let covered: Vec<AtomicBool> = (0..n).map(|_| AtomicBool::new(false)).collect();
    // Cost in the upper half, seed in the lower one: the order of these numbers is that of costs, then of seeds.
    let offers: Vec<AtomicU64> = (0..n).map(|_| AtomicU64::new(u64::MAX)).collect();
    for c in 0..level.colours.len() - 1 {
        threads.each(level.colours[c] as usize..level.colours[c + 1] as usize, |b| {
            for i in level.block(b) {
                if !level.connected(i) || covered[i].load(Ordering::Relaxed) {
                    continue;
                }
                offers[i].store(i as u64, Ordering::Relaxed);
                let here = if placed { level.positions[i] } else { Lanes::ZERO };
                for (j, w) in level.row(i) {
                    let length2 = if placed {
                        distance2(here, level.positions[j])
                    } else {
                        1.0
                    };
                    if j > i && (!placed || length2 <= reach2) && weak.get(j).is_none_or(|weak| w >= *weak) {
                        covered[j].store(true, Ordering::Relaxed);
                    }
                    let cost = (length2 / w).min(f32::MAX);
                    // Above every cost of a seed to itself.
                    let offer = (u64::from(cost.to_bits()) + 1) << 32 | i as u64;
                    if offer < offers[j].load(Ordering::Relaxed) {
                        if threads.parallel() {
                            offers[j].fetch_min(offer, Ordering::Relaxed);
                        } else {
                            offers[j].store(offer, Ordering::Relaxed);
                        }
                    }
                }
            }
        });
    }
    offers.into_iter().map(|offer| offer.into_inner() as u32).collect()
}

/// Greedy pairing along the heaviest edges, for graphs where seeds hardly thin out (stars, edges of very different
/// lengths): each row pairs with its heaviest unpaired neighbour, or joins its heaviest neighbour. Every aggregate has
/// at least two rows.
fn pair(level: &Level) -> (Vec<u32>, usize) {
    let mut aggregates = vec![NONE; level.rows()];
    let mut count = 0;
    for i in 0..level.rows() {
        if aggregates[i] != NONE || !level.connected(i) {
            continue;
        }
        let (mut open, mut any) = ((0.0, NONE), (0.0, NONE));
        for (j, w) in level.row(i) {
            let j = j as u32;
            let heavier = |best: (f32, u32)| w > best.0 || (w == best.0 && j < best.1);
            if heavier(any) {
                any = (w, j);
            }
            if aggregates[j as usize] == NONE && heavier(open) {
                open = (w, j);
            }
        }
        if open.1 != NONE {
            aggregates[i] = count;
            aggregates[open.1 as usize] = count;
            count += 1;
        } else {
            aggregates[i] = aggregates[any.1 as usize];
        }
    }
    (aggregates, count as usize)
}

#[cfg(test)]
mod tests {
    use super::super::layout::{Rows, arrange};
    use super::super::testing::{Block, pool};
    use super::*;

    fn threads() -> Threads {
        Threads::of(&pool())
    }

    fn level_of(offsets: &[u32], neighbours: &[u32], weights: Option<&[f32]>) -> Level {
        let rows = Rows {
            offsets,
            neighbours,
            weights,
            scale: 1.0,
        };
        let sequence: Vec<u32> = (0..offsets.len() as u32 - 1).collect();
        arrange(rows, &sequence, &[], 64, threads()).0
    }

    #[test]
    fn seeds_are_a_maximal_independent_set() {
        let hierarchy = Block::new(12, 11, 10).hierarchy(1);
        let level = &hierarchy.levels[0];
        // δ between the edge lengths 1 and √2: diagonal neighbours may both be seeds.
        for (ratio, separate) in [(0.99, 1.01), (0.1, 10.0)] {
            let nearest = nearest_seeds(level, ratio, threads());
            let reach2 = reach2(level, ratio);
            let length2 = |i: usize, j: usize| distance2(level.positions[i], level.positions[j]);
            let unit2 = level.row(0).map(|(j, _)| length2(0, j)).fold(f32::MAX, f32::min);
            assert!(separate < 2.0 || reach2 > 3.0 * unit2);
            for i in (0..level.rows()).filter(|&i| level.connected(i)) {
                let seed = |j: usize| nearest[j] == j as u32;
                let before = |j: usize| j < i && seed(j) && length2(i, j) <= reach2;
                let covered = level.row(i).any(|(j, _)| before(j));
                assert_eq!(seed(i), !covered, "row {i}");
            }
        }
    }

    #[test]
    fn rows_join_an_adjacent_seed() {
        let hierarchy = Block::new(12, 11, 10).weighted().hierarchy(1);
        let level = &hierarchy.levels[0];
        let nearest = nearest_seeds(level, 0.1, threads());
        for i in 0..level.rows() {
            if !level.connected(i) {
                assert_eq!(nearest[i], NONE);
            } else if nearest[i] != i as u32 {
                let cost = |j: usize, w: f32| distance2(level.positions[i], level.positions[j]) / w;
                let seeds = level.row(i).filter(|&(j, _)| nearest[j] == j as u32);
                let best = seeds.map(|(j, w)| cost(j, w)).fold(f32::MAX, f32::min);
                let taken = level.row(i).find(|&(j, _)| j as u32 == nearest[i]).unwrap();
                assert_eq!(cost(taken.0, taken.1), best);
            }
        }
    }

    #[test]
    fn stars_and_lone_rows_shrink() {
        // A star whose hub comes last, where seeds would be all its leaves, and a row without neighbours.
        let leaves = 100u32;
        let mut offsets: Vec<u32> = (0..=leaves).collect();
        offsets.extend([leaves, 2 * leaves]);
        let hub = leaves + 1;
        let mut neighbours = vec![hub; leaves as usize];
        neighbours.extend(0..leaves);
        let level = level_of(&offsets, &neighbours, None);
        let (groups, count) = aggregates(&level, 0.1, threads());
        assert_eq!(count, 1);
        let lone = (0..level.rows()).filter(|&i| groups[i] == NONE && !level.connected(i));
        assert_eq!(level.rows() - lone.count(), 101, "the lone row needs no coarse row");
        assert_eq!(groups.iter().filter(|&&g| g == 0).count(), 101);
    }

    #[test]
    fn pairs_follow_heavy_edges() {
        // A path of six with heavy edges 0-1, 2-3, 4-5.
        let weights = [9.0, 9.0, 1.0, 1.0, 9.0, 9.0, 1.0, 1.0, 9.0, 9.0];
        let level = level_of(&[0, 1, 3, 5, 7, 9, 10], &[1, 0, 2, 1, 3, 2, 4, 3, 5, 4], Some(&weights));
        let (groups, count) = pair(&level);
        assert_eq!(count, 3);
        for i in (0..level.rows()).filter(|&i| level.connected(i)) {
            let heavy = level.row(i).find(|(_, w)| *w == 9.0).unwrap().0;
            assert_eq!(groups[i], groups[heavy]);
        }
    }
}
