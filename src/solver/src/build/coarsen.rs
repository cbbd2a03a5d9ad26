//! Seeds and aggregates: which rows become one row of the next level (paper section 4).

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::build::draft::{LevelDraft, RowBlocks};
use crate::lanes::Lanes;
use crate::lanes::NO_ROW;
use crate::threads::{Parallelism, cut, piece_count, piece_rows};

/// Rows that one piece of work handles.
const PIECE: usize = 4096;

/// Rows whose edges make the sample for the mean edge length.
const SAMPLE: usize = 4096;

/// A neighbour whose edge weighs less than this part of a row's heaviest edge says too little about the row to stand
/// for it on the next level.
pub(crate) const WEAK: f32 = 0.02;

/// Seeds must leave at most this part of the rows, or the level is paired instead.
pub(crate) const SHRINK: f64 = 0.8;

/// Groups the rows of `draft`.
///
/// Groups are connected, and at most 80 % as many as there are rows with neighbours. They are numbered along the draft,
/// so that the next level inherits its order.
pub(crate) fn choose_aggregates(
    draft: &LevelDraft,
    blocks: &RowBlocks,
    ratio: f64,
    threads: Parallelism,
) -> Aggregates {
    let threads = threads.for_rows(draft.rows());
    let reach2 = reach2(draft, ratio);
    let nearest = nearest_seeds(draft, blocks, reach2, threads);
    // Neighbours come in pairs, so a row is connected exactly when it has joined something.
    let parts = threads.map(
        0..piece_count(draft.rows(), PIECE),
        || (),
        |(), k| {
            let range = piece_rows(k, draft.rows(), PIECE);
            let seeds: Vec<u32> = range
                .clone()
                .filter(|&i| nearest[i] == i as u32)
                .map(|i| i as u32)
                .collect();
            (seeds, nearest[range].iter().filter(|seed| **seed != NO_ROW).count())
        },
    );
    let connected: usize = parts.iter().map(|p| p.1).sum();
    let seeds: Vec<u32> = parts.into_iter().flat_map(|p| p.0).collect();
    if seeds.len() as f64 > SHRINK * connected as f64 {
        let (of_row, count) = pair_rows(draft);
        return Aggregates::new(of_row, count);
    }
    let mut numbers = vec![0u32; draft.rows()];
    for (number, &seed) in seeds.iter().enumerate() {
        numbers[seed as usize] = number as u32;
    }
    let mut aggregates = nearest;
    threads.for_each_piece(PIECE, aggregates.as_mut_slice(), |_, seeds| {
        for seed in seeds {
            if *seed != NO_ROW {
                *seed = numbers[*seed as usize];
            }
        }
    });
    Aggregates::around(&seeds, aggregates, reach2, draft, threads)
}

#[inline(always)]
pub(crate) fn distance2(a: Lanes, b: Lanes) -> f32 {
    let d = a - b;
    let [x, y, z, _] = (d * d).0;
    x + y + z
}

/// Mean length of the edges of evenly spread rows.
fn mean_edge(draft: &LevelDraft) -> f64 {
    let n = draft.rows();
    let samples = n.min(SAMPLE);
    let (mut total, mut edges) = (0.0, 0usize);
    for s in 0..samples {
        let i = (s as u64 * n as u64 / samples as u64) as usize;
        for &j in draft.row(i) {
            total += f64::from(distance2(draft.positions[i], draft.positions[j as usize])).sqrt();
        }
        edges += draft.row(i).len();
    }
    if edges > 0 { total / edges as f64 } else { 0.0 }
}

/// Largest (squared) distance of neighbours of which only one can be a seed: the paper's δ.
fn reach2(draft: &LevelDraft, ratio: f64) -> f32 {
    if draft.positions.is_empty() {
        return f32::INFINITY;
    }
    let delta = mean_edge(draft) * libm::cbrt(1.0 / ratio);
    (delta * delta) as f32
}

/// The paper's maximal δ-independent set, and for every row the seed it joins (a seed itself, [`NO_ROW`] for a row without
/// neighbours).
///
/// In sweep order, a row becomes a seed unless a seed before it is a (not weak) neighbour within δ. Each row joins the
/// adjacent seed with the least (squared distance) / weight, ties to the earlier one. Seeds write both to their
/// neighbours, so that only the rows of seeds are read. The order of writes does not matter: seeds in blocks of other
/// colours write to a block before or after its sweep, never during it, and joining takes a minimum.
fn nearest_seeds(draft: &LevelDraft, blocks: &RowBlocks, reach2: f32, threads: Parallelism) -> Vec<u32> {
    let n = draft.rows();
    let placed = !draft.positions.is_empty();
    let weak: Vec<f32> = match &draft.weights {
        None => Vec::new(),
        Some(w) => (0..n)
            .map(|i| WEAK * w[draft.entries(i)].iter().fold(0.0f32, |a, &b| a.max(b)))
            .collect(),
    };
    let covered: Vec<AtomicBool> = (0..n).map(|_| AtomicBool::new(false)).collect();
    let offers: Vec<AtomicU64> = (0..n).map(|_| AtomicU64::new(u64::MAX)).collect();
    let seen = SeedOffers {
        covered,
        offers,
        weak,
        reach2,
    };
    for c in blocks.colours.windows(2) {
        threads.for_each(c[0] as usize..c[1] as usize, |k| {
            for i in blocks.range(blocks.by_colour[k] as usize) {
                if !draft.connected(i) || seen.covered[i].load(Ordering::Relaxed) {
                    continue;
                }
                match (&draft.weights, placed) {
                    (None, true) => seen.take_seed::<false, true>(draft, i, threads),
                    (Some(_), true) => seen.take_seed::<true, true>(draft, i, threads),
                    (None, false) => seen.take_seed::<false, false>(draft, i, threads),
                    (Some(_), false) => seen.take_seed::<true, false>(draft, i, threads),
                }
            }
        });
    }
    let offers = seen.offers;
    offers.into_iter().map(|offer| offer.into_inner() as u32).collect()
}

/// What seeds wrote to rows.
struct SeedOffers {
    /// Whether a seed is near.
    covered: Vec<AtomicBool>,
    /// Cost in the upper half, seed in the lower one: the order of these numbers is that of costs, then of seeds.
    offers: Vec<AtomicU64>,
    /// The weight below which an edge covers nothing; empty where there are no weights.
    weak: Vec<f32>,
    reach2: f32,
}

impl SeedOffers {
    /// Makes row `i` a seed and updates its neighbours.
    #[inline(always)]
    fn take_seed<const WEIGHTED: bool, const PLACED: bool>(&self, draft: &LevelDraft, i: usize, threads: Parallelism) {
        self.offers[i].store(i as u64, Ordering::Relaxed);
        let at = |i: usize| if PLACED { draft.positions[i] } else { Lanes::ZERO };
        let here = at(i);
        for e in draft.entries(i) {
            let (j, w) = (
                draft.neighbours[e] as usize,
                if WEIGHTED { draft.weight(e) } else { 1.0 },
            );
            let length2 = if PLACED { distance2(here, at(j)) } else { 1.0 };
            // Rows before this one have had their turn: what they hear now changes nothing.
            let near = !PLACED || length2 <= self.reach2;
            if near & (!WEIGHTED || w >= self.weak[j]) {
                self.covered[j].store(true, Ordering::Relaxed);
            }
            let cost = if WEIGHTED { length2 / w } else { length2 }.min(f32::MAX);
            // Above every cost of a seed to itself.
            let offer = (u64::from(cost.to_bits()) + 1) << 32 | i as u64;
            let best = self.offers[j].load(Ordering::Relaxed);
            if !threads.parallel() {
                self.offers[j].store(best.min(offer), Ordering::Relaxed);
            } else if offer < best {
                self.offers[j].fetch_min(offer, Ordering::Relaxed);
            }
        }
    }
}

/// Greedy pairing along the heaviest edges, for graphs where seeds hardly thin out (stars, edges of very different
/// lengths): each row pairs with its heaviest unpaired neighbour, or joins its heaviest neighbour. Every aggregate has
/// at least two rows.
fn pair_rows(draft: &LevelDraft) -> (Vec<u32>, usize) {
    let mut aggregates = vec![NO_ROW; draft.rows()];
    let mut count = 0;
    for i in 0..draft.rows() {
        if aggregates[i] != NO_ROW || !draft.connected(i) {
            continue;
        }
        let (mut open, mut any) = ((0.0, NO_ROW), (0.0, NO_ROW));
        for e in draft.entries(i) {
            let (j, w) = (draft.neighbours[e], draft.weight(e));
            let heavier = |best: (f32, u32)| w > best.0 || (w == best.0 && j < best.1);
            if heavier(any) {
                any = (w, j);
            }
            if aggregates[j as usize] == NO_ROW && heavier(open) {
                open = (w, j);
            }
        }
        if open.1 != NO_ROW {
            aggregates[i] = count;
            aggregates[open.1 as usize] = count;
            count += 1;
        } else {
            aggregates[i] = aggregates[any.1 as usize];
        }
    }
    (aggregates, count as usize)
}

/// Groups that one piece of work gathers.
const SEED_PIECE: usize = 1024;

/// Groups whose seeds' rows are asked of memory before they are needed.
const AHEAD: usize = 8;

/// How the rows of a level were grouped, which a repair goes on with.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct AggregationRule {
    /// Largest (squared) distance of neighbours of which only one can be a seed.
    pub(crate) reach2: f32,
    /// True if there are no seeds: see [`coarsen`](super::coarsen).
    pub(crate) paired: bool,
}

/// The rows of a [`LevelDraft`] in groups, each of which becomes one row of the next level.
#[derive(Debug, Default)]
pub(crate) struct Aggregates {
    /// Number of the group of each row, or [`NO_ROW`] for a row without neighbours.
    pub(crate) of_row: Vec<u32>,
    /// Where the members of each group begin; ends with their number.
    pub(crate) offsets: Vec<u32>,
    /// Rows by group; the seed, if there is one, comes first.
    pub(crate) members: Vec<u32>,
    pub(crate) grouping: AggregationRule,
}

impl Aggregates {
    /// Groups without seeds.
    pub(crate) fn new(of_row: Vec<u32>, count: usize) -> Aggregates {
        let mut offsets = vec![0u32; count + 1];
        for &g in &of_row {
            if g != NO_ROW {
                offsets[g as usize + 1] += 1;
            }
        }
        for k in 0..count {
            offsets[k + 1] += offsets[k];
        }
        let mut cursor = offsets.clone();
        let mut members = vec![0u32; offsets[count] as usize];
        for (i, &g) in of_row.iter().enumerate() {
            if g != NO_ROW {
                members[cursor[g as usize] as usize] = i as u32;
                cursor[g as usize] += 1;
            }
        }
        let grouping = AggregationRule {
            reach2: 0.0,
            paired: true,
        };
        Aggregates {
            of_row,
            offsets,
            members,
            grouping,
        }
    }

    /// Groups of seeds and neighbours that have joined them; `seeds` ascend. Only the rows of seeds are
    /// read.
    pub(crate) fn around(
        seeds: &[u32],
        of_row: Vec<u32>,
        reach2: f32,
        draft: &LevelDraft,
        threads: Parallelism,
    ) -> Aggregates {
        let count = seeds.len();
        let parts = threads.map(
            0..piece_count(count, SEED_PIECE),
            || (),
            |(), k| {
                let range = piece_rows(k, count, SEED_PIECE);
                let most: usize = seeds[range.clone()]
                    .iter()
                    .map(|&s| 1 + draft.entries(s as usize).len())
                    .sum();
                let mut members = vec![0u32; most];
                let mut ends = Vec::with_capacity(range.len());
                let mut used = 0;
                for group in range {
                    if let Some(&later) = seeds.get(group + AHEAD) {
                        draft.prefetch_row(later as usize);
                    }
                    let seed = seeds[group];
                    members[used] = seed;
                    used += 1;
                    // Rows that have not joined are written too, and then overwritten: that is faster than asking.
                    let row = draft.row(seed as usize);
                    for &j in row {
                        members[used] = j;
                        used += usize::from(of_row[j as usize] == group as u32);
                    }
                    ends.push(used as u32);
                }
                members.truncate(used);
                (members, ends)
            },
        );
        let mut offsets = Vec::with_capacity(count + 1);
        offsets.push(0);
        let mut base = 0;
        for (members, ends) in &parts {
            offsets.extend(ends.iter().map(|end| base + end));
            base += members.len() as u32;
        }
        let mut members = vec![0u32; base as usize];
        let members_of_parts = cut(&mut members, parts.iter().map(|(members, _)| members.len()));
        threads.for_each_item(members_of_parts, || (), |(), k, out| out.copy_from_slice(&parts[k].0));
        let grouping = AggregationRule { reach2, paired: false };
        Aggregates {
            of_row,
            offsets,
            members,
            grouping,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    #[inline(always)]
    pub(crate) fn members_of(&self, group: usize) -> &[u32] {
        &self.members[self.offsets[group] as usize..self.offsets[group + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::draft::UnitBoxMap;
    use crate::build::draft::UnorderedRows;
    use crate::testing::{BoxLattice, pool};

    fn threads() -> Parallelism {
        Parallelism::from_pool(&pool())
    }

    fn draft_of(offsets: &[u32], neighbours: &[u32], weights: Option<&[f32]>, positions: &[Lanes]) -> LevelDraft {
        let rows = UnorderedRows {
            offsets,
            neighbours,
            weights,
            scale: 1.0,
            positions,
        };
        let sequence: Vec<u32> = (0..offsets.len() as u32 - 1).collect();
        LevelDraft::new(&rows, &sequence, threads())
    }

    fn draft_of_block(block: &BoxLattice) -> LevelDraft {
        let frame = UnitBoxMap::around(&block.positions);
        let positions: Vec<Lanes> = block.positions.iter().map(|&p| frame.apply(p)).collect();
        draft_of(&block.offsets, &block.neighbours, block.weights.as_deref(), &positions)
    }

    fn nearest(draft: &LevelDraft, ratio: f64) -> Vec<u32> {
        let reach2 = reach2(draft, ratio);
        nearest_seeds(draft, &RowBlocks::new(draft, 64, threads()), reach2, threads())
    }

    fn row(draft: &LevelDraft, i: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        draft
            .entries(i)
            .map(|e| (draft.neighbours[e] as usize, draft.weight(e)))
    }

    #[test]
    fn seeds_are_a_maximal_independent_set() {
        let level = &draft_of_block(&BoxLattice::new(12, 11, 10));
        // δ between the edge lengths 1 and √2: diagonal neighbours may both be seeds.
        for (ratio, separate) in [(0.99, 1.01), (0.1, 10.0)] {
            let nearest = nearest(level, ratio);
            let reach2 = reach2(level, ratio);
            let length2 = |i: usize, j: usize| distance2(level.positions[i], level.positions[j]);
            let unit2 = row(level, 0).map(|(j, _)| length2(0, j)).fold(f32::MAX, f32::min);
            assert!(separate < 2.0 || reach2 > 3.0 * unit2);
            for i in 0..level.rows() {
                let seed = |j: usize| nearest[j] == j as u32;
                let near = |j: usize| seed(j) && length2(i, j) <= reach2;
                let covered = row(level, i).any(|(j, _)| near(j));
                assert_eq!(seed(i), !covered, "row {i}");
            }
        }
    }

    #[test]
    fn rows_join_an_adjacent_seed() {
        let level = &draft_of_block(&BoxLattice::new(12, 11, 10).weighted());
        let nearest = nearest(level, 0.1);
        for i in 0..level.rows() {
            if !level.connected(i) {
                assert_eq!(nearest[i], NO_ROW);
            } else if nearest[i] != i as u32 {
                let cost = |j: usize, w: f32| distance2(level.positions[i], level.positions[j]) / w;
                let seeds = row(level, i).filter(|&(j, _)| nearest[j] == j as u32);
                let best = seeds.map(|(j, w)| cost(j, w)).fold(f32::MAX, f32::min);
                let taken = row(level, i).find(|&(j, _)| j as u32 == nearest[i]).unwrap();
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
        let level = draft_of(&offsets, &neighbours, None, &[]);
        let groups = choose_aggregates(&level, &RowBlocks::new(&level, 64, threads()), 0.1, threads());
        assert_eq!(groups.len(), 1);
        let lone = groups.of_row.iter().filter(|&&g| g == NO_ROW).count();
        assert_eq!(lone, 1, "the single row needs no coarse row");
        assert_eq!(groups.members_of(0).len(), 101);
    }

    #[test]
    fn pairs_follow_heavy_edges() {
        // A path of six with heavy edges 0-1, 2-3, 4-5.
        let weights = [9.0, 9.0, 1.0, 1.0, 9.0, 9.0, 1.0, 1.0, 9.0, 9.0];
        let neighbours = [1, 0, 2, 1, 3, 2, 4, 3, 5, 4];
        let level = draft_of(&[0, 1, 3, 5, 7, 9, 10], &neighbours, Some(&weights), &[]);
        let (groups, count) = pair_rows(&level);
        assert_eq!(count, 3);
        for i in (0..level.rows()).filter(|&i| level.connected(i)) {
            let heavy = row(&level, i).find(|(_, w)| *w == 9.0).unwrap().0;
            assert_eq!(groups[i], groups[heavy]);
        }
    }
}
