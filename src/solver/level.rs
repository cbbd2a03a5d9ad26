//! One level of the hierarchy: a weighted graph stored in the order in which it is swept.

use super::coarsen::Groups;
use super::lanes::{Lanes, Shared};
use super::threads::{Threads, piece, pieces};

/// Rows that one piece of work handles.
const PIECE: usize = 4096;

/// No aggregate: the row has no neighbours, so its own equation already determines it. Also: no vertex, a row of filling.
pub(crate) const NONE: u32 = u32::MAX;

/// Rows that are swept together. No two of them are adjacent.
pub(crate) const BUNDLE: usize = 4;

/// A graph in sweep order.
///
/// Rows come in *bundles* of four, bundles in *blocks*, blocks in *colours*. Two blocks of one colour are not adjacent,
/// so they can be swept at the same time with the result of sweeping them one after the other: index order is sweep
/// order. Nor are two rows of one bundle.
///
/// The entries of a bundle are stored side by side: the first neighbour of each of its rows, then the second, and so
/// on; those before the row first. Where rows differ in their numbers of neighbours, and where no fourth row was left
/// for a bundle, there is *filling*: entries of weight 0 that lead to the row [`Level::filling`], and rows without
/// neighbours. Rows of filling hold 0 in every vector.
#[derive(Debug, Default)]
pub(crate) struct Level {
    /// Where the entries of each bundle begin; ends with their number.
    pub(crate) offsets: Vec<u32>,
    /// For each bundle its first entry that leads to a later row.
    pub(crate) middles: Vec<u32>,
    pub(crate) neighbours: Vec<u32>,
    /// `None`: all 1, except filling.
    pub(crate) weights: Option<Vec<f32>>,
    /// Sum of the weights of each row; 0 for rows of filling.
    pub(crate) diagonal: Vec<f32>,
    /// Rows that are not filling.
    pub(crate) occupied: usize,
    /// First row of each block, and the end of the last one.
    pub(crate) blocks: Vec<u32>,
    /// First block of each colour, and the number of blocks.
    pub(crate) colours: Vec<u32>,
    /// Positions in the unit box, or empty.
    pub(crate) positions: Vec<Lanes>,
    /// Row of the next level that each row belongs to, or [`NONE`]. Empty on the coarsest level.
    pub(crate) aggregates: Vec<u32>,
    /// Where the members of each row of the next level begin in `members`.
    pub(crate) member_offsets: Vec<u32>,
    /// Rows of this level by aggregate.
    pub(crate) members: Vec<u32>,
}

impl Level {
    /// Rows, those of filling included.
    pub(crate) fn rows(&self) -> usize {
        self.diagonal.len()
    }

    /// The row that entries of filling lead to: the first of the last bundle, which is in no block.
    pub(crate) fn filling(&self) -> u32 {
        ((self.middles.len() - 1) * BUNDLE) as u32
    }

    /// Where the entries of bundle `k` begin, where those to later rows begin, and where they end.
    #[inline(always)]
    pub(crate) fn bundle(&self, k: usize) -> (usize, usize, usize) {
        (
            self.offsets[k] as usize,
            self.middles[k] as usize,
            self.offsets[k + 1] as usize,
        )
    }

    /// Neighbours of row `i` and their weights, without filling.
    #[inline(always)]
    pub(crate) fn row(&self, i: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let (begin, _, end) = self.bundle(i / BUNDLE);
        let filling = self.filling();
        (begin + i % BUNDLE..end)
            .step_by(BUNDLE)
            .map(move |e| (self.neighbours[e], self.weight(e)))
            .filter(move |&(j, _)| j != filling)
            .map(|(j, w)| (j as usize, w))
    }

    #[inline(always)]
    pub(crate) fn weight(&self, entry: usize) -> f32 {
        self.weights.as_ref().map_or(1.0, |w| w[entry])
    }

    /// True if row `i` has a neighbour.
    #[inline(always)]
    pub(crate) fn connected(&self, i: usize) -> bool {
        self.diagonal[i] > 0.0
    }

    /// Rows that are not filling.
    pub(crate) fn occupied(&self) -> usize {
        self.occupied
    }

    /// Undirected edges.
    pub(crate) fn edges(&self) -> usize {
        let filling = self.filling();
        self.neighbours.iter().filter(|&&j| j != filling).count() / 2
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

    /// Stores which row of the next level each row belongs to. `ranks` and `coarse_ranks` tell which rows the rows of
    /// the two drafts have become; `coarse_rows` is the number of rows of the next level, filling included.
    pub(crate) fn set_aggregates(
        &mut self,
        groups: &Groups,
        ranks: &[u32],
        coarse_ranks: &[u32],
        coarse_rows: usize,
        threads: Threads,
    ) {
        let n = ranks.len();
        let threads = threads.for_rows(n);
        self.aggregates = vec![NONE; self.rows()];
        let aggregates = Shared::new(&mut self.aggregates);
        threads.each(0..pieces(n, PIECE), |k| {
            for k in piece(k, n, PIECE) {
                let group = groups.of_row[k];
                if group != NONE {
                    // SAFETY: every row of the draft has its own row of the level; each is visited once.
                    unsafe { aggregates.set(ranks[k] as usize, coarse_ranks[group as usize]) };
                }
            }
        });
        let mut offsets = vec![0u32; coarse_rows + 1];
        for (group, &row) in coarse_ranks.iter().enumerate() {
            offsets[row as usize + 1] = groups.members_of(group).len() as u32;
        }
        for row in 0..coarse_rows {
            offsets[row + 1] += offsets[row];
        }
        self.members = vec![0; groups.members.len()];
        let members = Shared::new(&mut self.members);
        threads.each(0..pieces(coarse_ranks.len(), PIECE), |k| {
            for group in piece(k, coarse_ranks.len(), PIECE) {
                let row = coarse_ranks[group] as usize;
                // SAFETY: every group has its own row of the next level; each is visited once.
                let out = unsafe { members.rows(offsets[row] as usize..offsets[row + 1] as usize) };
                for (out, &i) in out.iter_mut().zip(groups.members_of(group)) {
                    *out = ranks[i as usize];
                }
            }
        });
        self.member_offsets = offsets;
    }
}
