//! One level of the hierarchy: a weighted graph stored in the order in which it is swept.

use super::lanes::{Lanes, Shared};
use super::threads::Threads;

/// No aggregate: the row has no neighbours, so its own equation already determines it.
pub(crate) const NONE: u32 = u32::MAX;

/// Rows of a graph in any order; the raw material of a [`Level`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<'a> {
    pub(crate) offsets: &'a [u32],
    pub(crate) neighbours: &'a [u32],
    pub(crate) weights: Option<&'a [f32]>,
    /// Factor on every weight.
    pub(crate) scale: f32,
}

impl Rows<'_> {
    fn degree(&self, i: usize) -> usize {
        (self.offsets[i + 1] - self.offsets[i]) as usize
    }
}

/// A graph in sweep order.
///
/// Rows come in *blocks* of consecutive rows, blocks in *colours*. Two blocks of one colour are not adjacent, so they
/// can be swept at the same time with the result of sweeping them one after the other: index order is sweep order.
/// In each row the neighbours before the row come first.
#[derive(Debug, Default)]
pub(crate) struct Level {
    pub(crate) offsets: Vec<u32>,
    /// First neighbour of each row that comes after the row.
    pub(crate) middles: Vec<u32>,
    pub(crate) neighbours: Vec<u32>,
    /// `None`: all 1.
    pub(crate) weights: Option<Vec<f32>>,
    /// Sum of the weights of each row.
    pub(crate) diagonal: Vec<f32>,
    /// First row of each block, and the number of rows.
    pub(crate) blocks: Vec<u32>,
    /// First block of each colour, and the number of blocks.
    pub(crate) colours: Vec<u32>,
    /// Positions in the unit box, or empty.
    pub(crate) positions: Vec<Lanes>,
    /// Row of the next level that each row belongs to, or [`NONE`]. Empty on the coarsest level.
    pub(crate) aggregates: Vec<u32>,
    /// Where the members of each row of the next level begin in `members`.
    pub(crate) member_offsets: Vec<u32>,
    /// Rows of this level by aggregate, ascending inside each.
    pub(crate) members: Vec<u32>,
}

impl Level {
    pub(crate) fn rows(&self) -> usize {
        self.diagonal.len()
    }

    /// Entries of row `i` before and after the row itself.
    #[inline(always)]
    pub(crate) fn entries(&self, i: usize) -> (usize, usize, usize) {
        (
            self.offsets[i] as usize,
            self.middles[i] as usize,
            self.offsets[i + 1] as usize,
        )
    }

    #[inline(always)]
    pub(crate) fn weight(&self, entry: usize) -> f32 {
        self.weights.as_ref().map_or(1.0, |w| w[entry])
    }

    /// Rows of block `b`.
    #[inline(always)]
    pub(crate) fn block(&self, b: usize) -> std::ops::Range<usize> {
        self.blocks[b] as usize..self.blocks[b + 1] as usize
    }

    /// Rows of this level that row `coarse` of the next one stands for.
    #[inline(always)]
    pub(crate) fn members_of(&self, coarse: usize) -> &[u32] {
        &self.members[self.member_offsets[coarse] as usize..self.member_offsets[coarse + 1] as usize]
    }

    /// Rows of the next level.
    pub(crate) fn coarse_rows(&self) -> usize {
        self.member_offsets.len().saturating_sub(1)
    }

    pub(crate) fn bytes(&self) -> usize {
        let words = self.offsets.len() + self.middles.len() + self.neighbours.len() + self.diagonal.len();
        let words = words + self.blocks.len() + self.colours.len() + self.aggregates.len();
        let words = words + self.member_offsets.len() + self.members.len();
        4 * (words + self.weights.as_ref().map_or(0, Vec::len)) + 16 * self.positions.len()
    }

    /// Stores which aggregate each row belongs to and lists the members of each.
    pub(crate) fn set_aggregates(&mut self, aggregates: Vec<u32>, count: usize) {
        let mut offsets = vec![0u32; count + 1];
        for &a in &aggregates {
            if a != NONE {
                offsets[a as usize + 1] += 1;
            }
        }
        for k in 0..count {
            offsets[k + 1] += offsets[k];
        }
        let mut cursor = offsets.clone();
        let mut members = vec![0u32; offsets[count] as usize];
        for (i, &a) in aggregates.iter().enumerate() {
            if a != NONE {
                members[cursor[a as usize] as usize] = i as u32;
                cursor[a as usize] += 1;
            }
        }
        self.aggregates = aggregates;
        self.member_offsets = offsets;
        self.members = members;
    }

    /// Brings `rows` into sweep order, starting from `sequence` (which should keep neighbours close), with blocks of
    /// `block` rows (a power of two). Returns the level and, for each of its rows, the row of `rows` it holds.
    ///
    /// `positions` are those of `rows`, or empty.
    pub(crate) fn arrange(
        rows: Rows<'_>,
        mut sequence: Vec<u32>,
        positions: &[Lanes],
        block: usize,
        threads: Threads,
    ) -> (Level, Vec<u32>) {
        let n = sequence.len();
        let threads = threads.for_rows(n);
        sort_blocks_by_degree(&rows, &mut sequence, block, threads);
        let (draft, adjacency) = draft(&rows, &sequence, block, threads);
        let (colours, by_colour) = colour(&adjacency);
        drop(adjacency);

        // Where each block of the draft goes.
        let blocks_of_draft = by_colour.len();
        let mut bases = vec![0u32; blocks_of_draft];
        let mut blocks = Vec::with_capacity(blocks_of_draft + 1);
        let mut total = 0u32;
        for &b in &by_colour {
            bases[b as usize] = total;
            blocks.push(total);
            total += (n - b as usize * block).min(block) as u32;
        }
        blocks.push(total);

        let mut order = vec![0u32; n];
        let mut offsets = vec![0u32; n + 1];
        for (k, &b) in by_colour.iter().enumerate() {
            let from = b as usize * block;
            for (local, i) in (blocks[k] as usize..blocks[k + 1] as usize).enumerate() {
                order[i] = sequence[from + local];
                offsets[i + 1] = offsets[i] + (draft.offsets[from + local + 1] - draft.offsets[from + local]);
            }
        }
        let mut level = Level {
            middles: vec![0; n],
            neighbours: vec![0; draft.neighbours.len()],
            weights: draft.weights.as_ref().map(|w| vec![0.0; w.len()]),
            diagonal: vec![0.0; n],
            positions: vec![Lanes::ZERO; positions.len()],
            offsets,
            blocks,
            colours,
            ..Level::default()
        };
        level.fill(&draft, &by_colour, &bases, block, threads);
        if !positions.is_empty() {
            for (p, &old) in level.positions.iter_mut().zip(&order) {
                *p = positions[old as usize];
            }
        }
        (level, order)
    }

    /// Copies the draft block by block into place, renames neighbours and puts those before each row first.
    fn fill(&mut self, draft: &Draft, by_colour: &[u32], bases: &[u32], block: usize, threads: Threads) {
        let shift = block.trailing_zeros();
        let mask = block as u32 - 1;
        let (offsets, blocks) = (&self.offsets, &self.blocks);
        let middles = Shared::new(&mut self.middles);
        let diagonal = Shared::new(&mut self.diagonal);
        let neighbours = Shared::new(&mut self.neighbours);
        let weights = self.weights.as_mut().map(|w| Shared::new(w));
        threads.each(0..by_colour.len(), |k| {
            let rows = blocks[k] as usize..blocks[k + 1] as usize;
            let entries = offsets[rows.start] as usize..offsets[rows.end] as usize;
            // SAFETY: blocks hold disjoint rows, and rows disjoint entries; each block is visited once.
            let (middles, diagonal, out) = unsafe {
                (
                    middles.rows(rows.clone()),
                    diagonal.rows(rows.clone()),
                    neighbours.rows(entries.clone()),
                )
            };
            // SAFETY: as above.
            let mut out_weights = weights.map(|w| unsafe { w.rows(entries.clone()) });
            let from = by_colour[k] as usize * block;
            for (local, i) in rows.enumerate() {
                let source = draft.offsets[from + local] as usize..draft.offsets[from + local + 1] as usize;
                // Both ends are written; the one that does not advance is overwritten by a later entry.
                let (mut low, mut high) = (
                    offsets[i] as usize - entries.start,
                    offsets[i + 1] as usize - entries.start,
                );
                let mut sum = 0.0f64;
                for s in source.clone() {
                    let j = draft.neighbours[s];
                    let j = bases[(j >> shift) as usize] + (j & mask);
                    let before = usize::from((j as usize) < i);
                    out[low] = j;
                    out[high - 1] = j;
                    if let (Some(out), Some(w)) = (out_weights.as_deref_mut(), &draft.weights) {
                        out[low] = w[s];
                        out[high - 1] = w[s];
                        sum += f64::from(w[s]);
                    }
                    low += before;
                    high -= 1 - before;
                }
                middles[local] = (low + entries.start) as u32;
                diagonal[local] = if draft.weights.is_some() {
                    sum as f32
                } else {
                    source.len() as f32
                };
            }
        });
    }
}

/// Inside each block rows of equal length come together: the inner loops then run the same number of times row after
/// row, which branch prediction rewards with half the time.
fn sort_blocks_by_degree(rows: &Rows<'_>, sequence: &mut [u32], block: usize, threads: Threads) {
    let n = sequence.len();
    let shared = Shared::new(sequence);
    threads.each(0..n.div_ceil(block), |b| {
        // SAFETY: each block is visited once.
        let part = unsafe { shared.rows(b * block..((b + 1) * block).min(n)) };
        let mut keyed: Vec<(u32, u32, u32)> = part
            .iter()
            .enumerate()
            .map(|(k, &i)| (rows.degree(i as usize) as u32, k as u32, i))
            .collect();
        keyed.sort_unstable();
        for (slot, (_, _, i)) in part.iter_mut().zip(keyed) {
            *slot = i;
        }
    });
}

/// The graph along the sequence, before its blocks are coloured.
struct Draft {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
    weights: Option<Vec<f32>>,
}

/// Copies the rows along `sequence` and lists, for each block, the other blocks it touches.
fn draft(rows: &Rows<'_>, sequence: &[u32], block: usize, threads: Threads) -> (Draft, Vec<Vec<u32>>) {
    let n = sequence.len();
    let shift = block.trailing_zeros();
    let mut ranks = vec![0u32; n];
    let mut offsets = vec![0u32; n + 1];
    for (k, &i) in sequence.iter().enumerate() {
        ranks[i as usize] = k as u32;
        offsets[k + 1] = offsets[k] + rows.degree(i as usize) as u32;
    }
    let mut neighbours = vec![0u32; rows.neighbours.len()];
    let mut weights = rows.weights.map(|w| vec![0.0f32; w.len()]);
    let blocks = n.div_ceil(block);
    let out = Shared::new(&mut neighbours);
    let out_weights = weights.as_mut().map(|w| Shared::new(w));
    let adjacency = threads.map(
        0..blocks,
        || vec![NONE; blocks],
        |stamps, b| {
            let range = b * block..((b + 1) * block).min(n);
            let entries = offsets[range.start] as usize..offsets[range.end] as usize;
            // SAFETY: blocks hold disjoint entries and each block is visited once.
            let out = unsafe { out.rows(entries.clone()) };
            // SAFETY: as above.
            let mut out_weights = out_weights.map(|w| unsafe { w.rows(entries.clone()) });
            let mut touched = Vec::new();
            let mut to = 0;
            stamps[b] = b as u32;
            for k in range {
                let i = sequence[k] as usize;
                for e in rows.offsets[i] as usize..rows.offsets[i + 1] as usize {
                    let j = ranks[rows.neighbours[e] as usize];
                    out[to] = j;
                    if let (Some(out), Some(w)) = (out_weights.as_deref_mut(), rows.weights) {
                        out[to] = w[e] * rows.scale;
                    }
                    to += 1;
                    let other = (j >> shift) as usize;
                    if stamps[other] != b as u32 {
                        stamps[other] = b as u32;
                        touched.push(other as u32);
                    }
                }
            }
            touched
        },
    );
    (
        Draft {
            offsets,
            neighbours,
            weights,
        },
        adjacency,
    )
}

/// Colours blocks greedily in their order. Returns the first block of each colour and the blocks colour by colour.
fn colour(adjacency: &[Vec<u32>]) -> (Vec<u32>, Vec<u32>) {
    let mut colour_of = vec![NONE; adjacency.len()];
    let mut taken: Vec<usize> = Vec::new();
    for (b, others) in adjacency.iter().enumerate() {
        for &other in others {
            let c = colour_of[other as usize];
            if c != NONE {
                taken[c as usize] = b + 1;
            }
        }
        let free = taken.iter().position(|&t| t != b + 1).unwrap_or(taken.len());
        if free == taken.len() {
            taken.push(0);
        }
        colour_of[b] = free as u32;
    }
    let mut begins = vec![0u32; taken.len() + 1];
    for &c in &colour_of {
        begins[c as usize + 1] += 1;
    }
    for c in 0..taken.len() {
        begins[c + 1] += begins[c];
    }
    let mut cursor = begins.clone();
    let mut by_colour = vec![0u32; adjacency.len()];
    for (b, &c) in colour_of.iter().enumerate() {
        by_colour[cursor[c as usize] as usize] = b as u32;
        cursor[c as usize] += 1;
    }
    (begins, by_colour)
}

#[cfg(test)]
mod tests {
    use super::super::testing::Block;

    #[test]
    fn arranging_keeps_the_graph() {
        let block = Block::new(9, 8, 7).weighted();
        let hierarchy = block.hierarchy(1);
        let level = &hierarchy.levels[0];
        let mut ranks = vec![0; level.rows()];
        for (row, &vertex) in hierarchy.order.iter().enumerate() {
            ranks[vertex as usize] = row as u32;
        }
        for (row, &vertex) in hierarchy.order.iter().enumerate() {
            let vertex = vertex as usize;
            let source = block.offsets[vertex] as usize..block.offsets[vertex + 1] as usize;
            let weights = block.weights.as_ref().unwrap();
            let scale = hierarchy.weight_scale as f32;
            let mut want: Vec<(u32, f32)> = source
                .map(|e| (ranks[block.neighbours[e] as usize], weights[e] * scale))
                .collect();
            let (begin, middle, end) = level.entries(row);
            let mut seen: Vec<(u32, f32)> = (begin..end).map(|e| (level.neighbours[e], level.weight(e))).collect();
            want.sort_by_key(|w| w.0);
            seen.sort_by_key(|w| w.0);
            assert_eq!(seen, want);
            assert!(level.neighbours[begin..middle].iter().all(|&j| (j as usize) < row));
            assert!(level.neighbours[middle..end].iter().all(|&j| (j as usize) > row));
            let sum: f32 = want.iter().map(|w| w.1).sum();
            assert!((sum - level.diagonal[row]).abs() < 1e-4 * sum);
        }
    }

    /// The promise on which parallel sweeps and their unsafe code rest.
    #[test]
    fn blocks_of_one_colour_do_not_touch() {
        let block = Block::new(14, 13, 12);
        let hierarchy = block.hierarchy(1);
        for level in &hierarchy.levels {
            assert_eq!(level.blocks.first(), Some(&0));
            assert_eq!(*level.blocks.last().unwrap() as usize, level.rows());
            assert_eq!(*level.colours.last().unwrap() as usize, level.blocks.len() - 1);
            let block_of = |row: u32| level.blocks.partition_point(|&b| b <= row) - 1;
            let colour_of = |row: u32| level.colours.partition_point(|&c| c as usize <= block_of(row)) - 1;
            for row in 0..level.rows() as u32 {
                let (begin, _, end) = level.entries(row as usize);
                for &j in &level.neighbours[begin..end] {
                    assert!(block_of(row) == block_of(j) || colour_of(row) != colour_of(j));
                }
            }
        }
        assert!(hierarchy.levels[0].colours.len() > 2 && hierarchy.levels.len() > 2);
    }
}
