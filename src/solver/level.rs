//! One level of the hierarchy: a weighted graph stored in the order in which it is swept.

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
    /// Rows of this level by aggregate, ascending inside each.
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

    /// Gives aggregate `order[k]` the number k. [`NONE`] in `order` makes an aggregate without members.
    pub(crate) fn renumber_aggregates(&mut self, order: &[u32], threads: Threads) {
        let mut numbers = vec![0u32; self.coarse_rows()];
        let mut offsets = Vec::with_capacity(order.len() + 1);
        let mut members = Vec::with_capacity(self.members.len());
        offsets.push(0);
        for (k, &old) in order.iter().enumerate() {
            if old != NONE {
                numbers[old as usize] = k as u32;
                members.extend_from_slice(self.members_of(old as usize));
            }
            offsets.push(members.len() as u32);
        }
        self.member_offsets = offsets;
        self.members = members;
        let n = self.rows();
        let aggregates = Shared::new(&mut self.aggregates);
        threads.for_rows(n).each(0..pieces(n, PIECE), |k| {
            // SAFETY: pieces are disjoint and each is visited once.
            for a in unsafe { aggregates.rows(piece(k, n, PIECE)) } {
                if *a != NONE {
                    *a = numbers[*a as usize];
                }
            }
        });
    }
}
