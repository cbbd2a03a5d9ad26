//! Bringing a graph into sweep order: blocks by colour, the rows of each in bundles.
//!
//! A sweep over irregular rows is bound by mispredicted branches and by waiting, not by arithmetic. Here the rows of a
//! block are coloured in turn, and four rows of one colour with (nearly) equal numbers of neighbours before and after
//! them make a *bundle*: one loop serves four rows, and four independent sums are under way at any time.

use crate::build::bundling::SlicePlanner;
use crate::build::draft::{LevelDraft, RowBlocks};
use crate::build::level::{HierarchyLevel, SliceExtent};
use crate::lanes::{Lanes, SLICE_ROWS, SharedRows, grow};
use crate::threads::{Parallelism, cut};
use std::ops::Range;

/// Rows that one piece of work handles where there are no blocks.
const PIECE: usize = 4096;

/// Brings `draft` into sweep order. Returns the level, without aggregates, and the row that each row of the draft has
/// become.
pub(crate) fn arrange_rows(draft: &LevelDraft, blocks: &RowBlocks, threads: Parallelism) -> (HierarchyLevel, Vec<u32>) {
    let mut level = HierarchyLevel {
        weights: draft.weights.as_ref().map(|_| Vec::new()),
        blocks: vec![0],
        colours: vec![0],
        ..HierarchyLevel::default()
    };
    let ranks = append_rows(&mut level, draft, &[], blocks, threads);
    (level, ranks)
}

/// Puts the rows of `draft` behind all that `level` has, in blocks and colours of their own. Returns the row that each
/// has become, and from [`RowBlocks::padded`] on the rows of `foreign`, which the draft's foreign neighbours stand for.
///
/// The rows of `foreign` do not get their new neighbours, and new rows have no aggregates.
pub(crate) fn append_rows(
    level: &mut HierarchyLevel,
    draft: &LevelDraft,
    foreign: &[u32],
    blocks: &RowBlocks,
    threads: Parallelism,
) -> Vec<u32> {
    let n = draft.rows();
    let threads = threads.for_rows(n);
    let (block, by_colour) = (blocks.size, &blocks.by_colour);
    // Foreign rows come before all.
    let mut places = vec![0u32; by_colour.len() + foreign.len().div_ceil(block)];
    for (place, &b) in (1..).zip(by_colour) {
        places[b as usize] = place;
    }

    let mut ranks = vec![0u32; n];
    let plans = threads.map_pieces(
        block,
        ranks.as_mut_slice(),
        SlicePlanner::new,
        |scratch, first, slots| scratch.plan_slices(draft, blocks, &places, first / block, slots),
    );

    let first = level.bundles.len();
    if first > 0 && level.blocks.last() == Some(&level.filling_row) {
        // The bundle of filling gets a block, so that others can follow.
        level.blocks.push(level.filling_row + SLICE_ROWS as u32);
        level.colours.push(level.blocks.len() as u32 - 1);
    }
    // Rows and entries block by block in the order of colours.
    let first_block = level.blocks.len() - 1;
    let mut bases = vec![0u32; by_colour.len()];
    let bundles: usize = plans.iter().map(Vec::len).sum();
    level.bundles.reserve_exact(bundles + 1);
    let begin = level.neighbours.len() as u32;
    let mut total = begin;
    for &b in by_colour {
        bases[b as usize] = (level.bundles.len() * SLICE_ROWS) as u32;
        for &[before, after] in &plans[b as usize] {
            let middle = total + SLICE_ROWS as u32 * before;
            let end = middle + SLICE_ROWS as u32 * after;
            level.bundles.push(SliceExtent {
                begin: total,
                middle,
                end,
            });
            total = end;
        }
        level.blocks.push((level.bundles.len() * SLICE_ROWS) as u32);
    }
    drop(plans);
    let number = |b: usize| first_block as u32 + places[b] - 1;
    level.along_curve.extend((0..by_colour.len()).map(number));
    let colours = blocks.colours[1..].iter().map(|&c| first_block as u32 + c);
    level.colours.extend(colours);
    if first == 0 {
        // One bundle of nothing but filling, which no block holds.
        level.filling_row = (level.bundles.len() * SLICE_ROWS) as u32;
        level.bundles.push(SliceExtent {
            begin: total,
            middle: total,
            end: total,
        });
    }
    let (rows, entries) = ((level.bundles.len() - first) * SLICE_ROWS, (total - begin) as usize);
    level.occupied_rows += n;
    level.entries += entries;
    grow(&mut level.neighbours, entries, 0);
    if let Some(weights) = &mut level.weights {
        grow(weights, entries, 0.0);
    }
    grow(&mut level.diagonal, rows, 0.0);
    let placed = !draft.positions.is_empty();
    if placed {
        grow(&mut level.positions, rows, Lanes::ZERO);
    }

    let shift = block.trailing_zeros();
    let positions = SharedRows::new(&mut level.positions);
    threads.for_each_piece(PIECE, ranks.as_mut_slice(), |first, ranks| {
        for (k, rank) in (first..).zip(ranks) {
            *rank += bases[k >> shift];
            if placed {
                // SAFETY: every row of the draft has its own row of the level; each is visited once.
                unsafe { positions.set(*rank as usize, draft.positions[k]) };
            }
        }
    });
    if !foreign.is_empty() {
        ranks.resize(blocks.padded(), 0);
        ranks.extend(foreign);
    }
    copy_into_slices(level, first_block, draft, blocks, &ranks, threads);
    ranks
}

/// Where the rows of one block go.
struct BlockTarget<'a> {
    diagonal: &'a mut [f32],
    neighbours: &'a mut [u32],
    weights: Option<&'a mut [f32]>,
}

/// Scratch for copying one block.
#[derive(Default)]
struct BlockScratch {
    /// Where the entries of each row begin and end in `renamed`; filling has none.
    rows_from: Vec<[u32; 2]>,
    /// The block's entries as the level's rows. Renaming all at once asks nothing, so that the processor waits for many of them
    /// at the same time.
    renamed: Vec<u32>,
}

impl BlockScratch {
    /// Takes in the draft's rows `source`, which become the level's `rows`; answers where their entries are in the draft.
    fn take_block(
        &mut self,
        draft: &LevelDraft,
        source: Range<usize>,
        ranks: &[u32],
        rows: &Range<usize>,
    ) -> Range<usize> {
        let first = draft.offsets[source.start];
        let source_entries = first as usize..draft.offsets[source.end] as usize;
        self.rows_from.clear();
        self.rows_from.resize(rows.len(), [0; 2]);
        for (&rank, from) in ranks[source.clone()]
            .iter()
            .zip(draft.offsets[source.start..=source.end].windows(2))
        {
            self.rows_from[rank as usize - rows.start] = [from[0] - first, from[1] - first];
        }
        self.renamed.clear();
        self.renamed.extend(
            draft.neighbours[source_entries.clone()]
                .iter()
                .map(|&j| ranks[j as usize]),
        );
        source_entries
    }
}

/// Copies the draft block by block into bundles, renames neighbours and puts those before each row first.
///
/// Rows go in the order of bundles, where those that follow one another have nearly always the same numbers of neighbours: how
/// long the next row is need not be guessed.
fn copy_into_slices(
    level: &mut HierarchyLevel,
    first_block: usize,
    draft: &LevelDraft,
    blocks: &RowBlocks,
    ranks: &[u32],
    threads: Parallelism,
) {
    let filling = level.filling();
    let (bundles, block_rows) = (&level.bundles, &level.blocks[first_block..]);
    let rows_of = |k: usize| block_rows[k] as usize..block_rows[k + 1] as usize;
    let entries_of = |k: usize| {
        let rows = rows_of(k);
        bundles[rows.start / SLICE_ROWS].begin as usize..bundles[rows.end / SLICE_ROWS - 1].end as usize
    };
    let count = blocks.by_colour.len();
    if count == 0 {
        return;
    }
    let lengths = (0..count).map(|k| entries_of(k).len());
    let first_entry = entries_of(0).start;
    let diagonals = cut(
        &mut level.diagonal[rows_of(0).start..],
        (0..count).map(|k| rows_of(k).len()),
    );
    let neighbours = cut(&mut level.neighbours[first_entry..], lengths.clone());
    let weights = level.weights.as_mut().map(|w| cut(&mut w[first_entry..], lengths));
    let mut weights = weights.map(Vec::into_iter);
    let targets = diagonals
        .into_iter()
        .zip(neighbours)
        .map(|(diagonal, neighbours)| BlockTarget {
            diagonal,
            neighbours,
            weights: weights.as_mut().and_then(Iterator::next),
        });
    threads.for_each_item(targets.collect(), BlockScratch::default, |scratch, k, target| {
        let (rows, entries) = (rows_of(k), entries_of(k));
        let source = blocks.range(blocks.by_colour[k] as usize);
        let source_entries = scratch.take_block(draft, source, ranks, &rows);
        let BlockScratch { rows_from, renamed } = scratch;
        let from_weights = draft.weights.as_deref().map(|w| &w[source_entries]);
        let BlockTarget {
            diagonal,
            neighbours: out,
            weights: mut out_weights,
        } = target;
        for (i, &[from, to]) in rows.clone().zip(&*rows_from) {
            let (bundle, lane) = (bundles[i / SLICE_ROWS], i % SLICE_ROWS);
            // From both ends: every entry is written at both, and the end that does not advance is written again.
            let mut low = bundle.begin as usize - entries.start + lane;
            let mut high = bundle.end as usize - entries.start + lane;
            let source = from as usize..to as usize;
            let mut sum = 0.0f64;
            match (out_weights.as_deref_mut(), from_weights) {
                (Some(out_weights), Some(w)) => {
                    for (&j, &w) in renamed[source.clone()].iter().zip(&w[source]) {
                        let before = usize::from((j as usize) < i);
                        out[low] = j;
                        out[high - SLICE_ROWS] = j;
                        out_weights[low] = w;
                        out_weights[high - SLICE_ROWS] = w;
                        sum += f64::from(w);
                        low += SLICE_ROWS * before;
                        high -= SLICE_ROWS * (1 - before);
                    }
                    for e in (low..high).step_by(SLICE_ROWS) {
                        out_weights[e] = 0.0;
                    }
                }
                _ => {
                    sum = source.len() as f64;
                    for &j in &renamed[source] {
                        let before = usize::from((j as usize) < i);
                        out[low] = j;
                        out[high - SLICE_ROWS] = j;
                        low += SLICE_ROWS * before;
                        high -= SLICE_ROWS * (1 - before);
                    }
                }
            }
            for e in (low..high).step_by(SLICE_ROWS) {
                out[e] = filling;
            }
            debug_assert!(from == to || low <= bundle.middle as usize - entries.start + lane);
            diagonal[i - rows.start] = sum as f32;
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::NO_ROW;
    use crate::testing::BoxLattice;

    #[test]
    fn arranging_keeps_the_graph() {
        let block = BoxLattice::new(9, 8, 7).weighted();
        let hierarchy = block.hierarchy(1);
        let level = &hierarchy.levels[0];
        let mut ranks = vec![0; block.positions.len()];
        for (row, &vertex) in hierarchy.order.iter().enumerate().filter(|o| *o.1 != NO_ROW) {
            ranks[vertex as usize] = row as u32;
        }
        let mut filling = 0;
        for (row, &vertex) in hierarchy.order.iter().enumerate() {
            if vertex == NO_ROW {
                filling += 1;
                assert_eq!(level.row(row).count(), 0);
                assert_eq!(level.diagonal[row], 0.0);
                continue;
            }
            let vertex = vertex as usize;
            let source = block.offsets[vertex] as usize..block.offsets[vertex + 1] as usize;
            let weights = block.weights.as_ref().unwrap();
            let scale = hierarchy.weight_scale as f32;
            let mut want: Vec<(u32, f32)> = source
                .map(|e| (ranks[block.neighbours[e] as usize], weights[e] * scale))
                .collect();
            let mut seen: Vec<(u32, f32)> = level.row(row).map(|(j, w)| (j as u32, w)).collect();
            want.sort_by_key(|w| w.0);
            seen.sort_by_key(|w| w.0);
            assert_eq!(seen, want);
            let (begin, middle, end) = level.slice_extent(row / SLICE_ROWS);
            for e in (begin + row % SLICE_ROWS..end).step_by(SLICE_ROWS) {
                let j = level.neighbours[e] as usize;
                assert!(j == level.filling() as usize || (j < row) == (e < middle));
            }
            let sum: f32 = want.iter().map(|w| w.1).sum();
            assert!((sum - level.diagonal[row]).abs() < 1e-4 * sum);
        }
        // Small graphs have few rows to choose from for a bundle.
        let allowed = level.rows() / if cfg!(miri) { 2 } else { 10 };
        assert!(filling < allowed, "{filling} of {}", level.rows());
    }

    /// The promise on which parallel sweeps and their unsafe code rest, and that of sweeping four rows at a time.
    #[test]
    fn blocks_of_one_colour_and_rows_of_one_bundle_do_not_touch() {
        let block = BoxLattice::new(14, 13, 12);
        let hierarchy = block.hierarchy(1);
        for level in &hierarchy.levels {
            assert_eq!(level.blocks.first(), Some(&0));
            assert_eq!(*level.blocks.last().unwrap() as usize + SLICE_ROWS, level.rows());
            assert_eq!(*level.colours.last().unwrap() as usize, level.blocks.len() - 1);
            let block_of = |row: usize| level.blocks.partition_point(|&b| b as usize <= row) - 1;
            let colour_of = |row: usize| level.colours.partition_point(|&c| c as usize <= block_of(row)) - 1;
            for row in 0..level.rows() {
                for (j, _) in level.row(row) {
                    assert!(block_of(row) == block_of(j) || colour_of(row) != colour_of(j));
                    assert_ne!(row / SLICE_ROWS, j / SLICE_ROWS, "rows {row} and {j} are adjacent");
                }
            }
        }
        assert!(cfg!(miri) || hierarchy.levels[0].colours.len() > 2 && hierarchy.levels.len() > 2);
    }

    #[test]
    fn graphs_without_independent_rows_are_bundled_one_by_one() {
        // A complete graph: no two rows can share a bundle.
        let n = 70u32;
        let offsets: Vec<u32> = (0..=n).map(|i| i * (n - 1)).collect();
        let neighbours: Vec<u32> = (0..n).flat_map(|i| (0..n).filter(move |&j| j != i)).collect();
        let draft = LevelDraft {
            offsets,
            neighbours,
            ..LevelDraft::default()
        };
        let threads = Parallelism::from_pool(&crate::testing::pool());
        let (level, mut ranks) = arrange_rows(&draft, &RowBlocks::new(&draft, 64, threads), threads);
        ranks.sort_unstable();
        ranks.dedup();
        assert_eq!(ranks.len(), 70);
        let filled = (0..level.rows()).filter(|&i| level.diagonal[i] == 69.0).count();
        assert_eq!(filled, 70);
    }
}
