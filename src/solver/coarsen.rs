//! Seeds and aggregates: which rows become one row of the next level (paper section 4).

use super::lanes::Shared;
use super::level::{Level, NONE};
use super::threads::Threads;

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
    let connected = (0..level.rows())
        .filter(|&i| level.offsets[i] < level.offsets[i + 1])
        .count();
    let seeds = seeds(level, ratio, threads);
    let count = seeds.iter().filter(|&&s| s != NONE).count();
    if count as f64 <= SHRINK * connected as f64 {
        (join_seeds(level, &seeds, threads), count)
    } else {
        pair(level)
    }
}

fn distance2(level: &Level, i: usize, j: usize) -> f32 {
    let d = level.positions[i] - level.positions[j];
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
        let (begin, _, end) = level.entries(i);
        for e in begin..end {
            total += f64::from(distance2(level, i, level.neighbours[e] as usize)).sqrt();
        }
        edges += end - begin;
    }
    if edges > 0 { total / edges as f64 } else { 0.0 }
}

/// The paper's maximal δ-independent set: a row is a seed unless a seed before it is a (not weak) neighbour within δ.
/// Numbers the seeds in sweep order; other rows get [`NONE`].
fn seeds(level: &Level, ratio: f64, threads: Threads) -> Vec<u32> {
    let n = level.rows();
    let limit2 = if level.positions.is_empty() {
        f32::INFINITY
    } else {
        let delta = mean_edge(level) * libm::cbrt(1.0 / ratio);
        (delta * delta) as f32
    };
    let mut flags = vec![false; n];
    let shared = Shared::new(&mut flags);
    for c in 0..level.colours.len() - 1 {
        threads.each(level.colours[c] as usize..level.colours[c + 1] as usize, |b| {
            for i in level.block(b) {
                let (begin, middle, end) = level.entries(i);
                if begin == end {
                    continue;
                }
                let weak = level.weights.as_ref().map_or(0.0, |w| WEAK * heaviest(&w[begin..end]));
                let covered = (begin..middle).any(|e| {
                    let j = level.neighbours[e] as usize;
                    // SAFETY: in range; j is in this block or one of another colour, which no thread writes now.
                    let seed = unsafe { shared.get(j) };
                    seed && level.weight(e) >= weak && (level.positions.is_empty() || distance2(level, i, j) <= limit2)
                });
                // SAFETY: row i belongs to this block, which one thread sweeps.
                unsafe { shared.set(i, !covered) };
            }
        });
    }
    let mut count = 0;
    let number = |flag: bool| {
        if flag {
            count += 1;
            count - 1
        } else {
            NONE
        }
    };
    flags.into_iter().map(number).collect()
}

fn heaviest(weights: &[f32]) -> f32 {
    weights.iter().fold(0.0, |a, &b| a.max(b))
}

/// Every row joins the adjacent seed with the least (squared distance) / weight, ties to the smaller number.
fn join_seeds(level: &Level, seeds: &[u32], threads: Threads) -> Vec<u32> {
    let mut aggregates = seeds.to_vec();
    let shared = Shared::new(&mut aggregates);
    threads.each(0..level.blocks.len() - 1, |b| {
        for i in level.block(b) {
            let (begin, _, end) = level.entries(i);
            if seeds[i] != NONE || begin == end {
                continue;
            }
            let mut best = (f32::INFINITY, NONE);
            for e in begin..end {
                let j = level.neighbours[e] as usize;
                let seed = seeds[j];
                if seed == NONE {
                    continue;
                }
                let length2 = if level.positions.is_empty() {
                    1.0
                } else {
                    distance2(level, i, j)
                };
                let cost = (length2 / level.weight(e)).min(f32::MAX);
                if cost < best.0 || (cost == best.0 && seed < best.1) {
                    best = (cost, seed);
                }
            }
            // SAFETY: row i belongs to this block, which one thread visits.
            unsafe { shared.set(i, best.1) };
        }
    });
    aggregates
}

/// Greedy pairing along the heaviest edges, for graphs where seeds hardly thin out (stars, edges of very different
/// lengths): each row pairs with its heaviest unpaired neighbour, or joins its heaviest neighbour. Every aggregate has
/// at least two rows.
fn pair(level: &Level) -> (Vec<u32>, usize) {
    let mut aggregates = vec![NONE; level.rows()];
    let mut count = 0;
    for i in 0..level.rows() {
        let (begin, _, end) = level.entries(i);
        if aggregates[i] != NONE || begin == end {
            continue;
        }
        let (mut open, mut any) = ((0.0, NONE), (0.0, NONE));
        for e in begin..end {
            let (w, j) = (level.weight(e), level.neighbours[e]);
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
    use super::super::level::Rows;
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
        Level::arrange(rows, (0..offsets.len() as u32 - 1).collect(), &[], 64, threads()).0
    }

    #[test]
    fn seeds_are_a_maximal_independent_set() {
        let hierarchy = Block::new(12, 11, 10).hierarchy(1);
        let level = &hierarchy.levels[0];
        // δ between the edge lengths 1 and √2: diagonal neighbours may both be seeds.
        for (ratio, separate) in [(0.99, 1.01), (0.1, 10.0)] {
            let seeds = seeds(level, ratio, threads());
            let delta2 = (mean_edge(level) * libm::cbrt(1.0 / ratio)).powi(2) as f32;
            let unit2 = distance2(level, 0, level.neighbours[0] as usize);
            assert!(separate < 2.0 || delta2 > 3.0 * unit2);
            for i in 0..level.rows() {
                let (begin, _, end) = level.entries(i);
                let near = level.neighbours[begin..end].iter().map(|&j| j as usize);
                let mut covered = near.filter(|&j| seeds[j] != NONE && distance2(level, i, j) <= delta2);
                assert_eq!(seeds[i] == NONE, covered.next().is_some(), "row {i}");
            }
        }
    }

    #[test]
    fn rows_join_an_adjacent_seed() {
        let hierarchy = Block::new(12, 11, 10).weighted().hierarchy(1);
        let level = &hierarchy.levels[0];
        let seeds = seeds(level, 0.1, threads());
        let joined = join_seeds(level, &seeds, threads());
        for i in 0..level.rows() {
            let (begin, _, end) = level.entries(i);
            let cost = |e: usize| distance2(level, i, level.neighbours[e] as usize) / level.weight(e);
            let options = (begin..end).filter(|&e| seeds[level.neighbours[e] as usize] != NONE);
            if seeds[i] != NONE {
                assert_eq!(joined[i], seeds[i]);
            } else {
                let best = options.min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap();
                let taken = (begin..end)
                    .find(|&e| seeds[level.neighbours[e] as usize] == joined[i])
                    .unwrap();
                assert_eq!(cost(taken), cost(best));
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
        assert_eq!(
            groups.iter().filter(|&&g| g == NONE).count(),
            1,
            "the lone row needs no coarse row"
        );
        assert_eq!(groups.iter().filter(|&&g| g == 0).count(), 101);
    }

    #[test]
    fn pairs_follow_heavy_edges() {
        // A path of six with heavy edges 0-1, 2-3, 4-5.
        let weights = [9.0, 9.0, 1.0, 1.0, 9.0, 9.0, 1.0, 1.0, 9.0, 9.0];
        let level = level_of(&[0, 1, 3, 5, 7, 9, 10], &[1, 0, 2, 1, 3, 2, 4, 3, 5, 4], Some(&weights));
        let (groups, count) = pair(&level);
        assert_eq!(count, 3);
        for i in 0..6 {
            let (begin, _, end) = level.entries(i);
            let heavy = (begin..end).find(|&e| level.weight(e) == 9.0).unwrap();
            assert_eq!(groups[i], groups[level.neighbours[heavy] as usize]);
        }
    }
}
