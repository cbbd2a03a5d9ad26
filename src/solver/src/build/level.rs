//! One level of the hierarchy: a weighted graph stored in the order in which it is swept.

use rayon::prelude::*;

use crate::build::coarsen::{Aggregates, AggregationRule};
use crate::lanes::{Lanes, RowVectors, SharedRows};
use crate::lanes::{NO_ROW, SLACK, SLICE_ROWS};
use crate::threads::{Parallelism, piece_count, piece_rows};

/// Rows that one piece of work handles.
const PIECE: usize = 4096;

/// A graph in sweep order.
///
/// Rows come in *bundles* of four, bundles in *blocks*, blocks in *colours*. Two blocks of one colour are not adjacent,
/// so they can be swept at the same time with the result of sweeping them one after the other: index order is sweep
/// order. Nor are two rows of one bundle.
///
/// The entries of a bundle are stored side by side: the first neighbour of each of its rows, then the second, and so
/// on; those before the row first. Where rows differ in their numbers of neighbours, and where no fourth row was left
/// for a bundle, there is *filling*: entries of weight 0 that lead to the row [`HierarchyLevel::filling`], and rows without
/// neighbours. Rows of filling hold 0 in every vector.
///
/// A level that was built stands without gaps, and the bundle of filling comes last. A repair moves rows: their old
/// places become filling, and new blocks follow after that bundle, each colour behind all earlier ones.
#[derive(Debug, Clone, Default)]
pub(crate) struct HierarchyLevel {
    pub(crate) bundles: Vec<SliceExtent>,
    /// Entries of all bundles. After a repair there are gaps that no bundle refers to.
    pub(crate) neighbours: Vec<u32>,
    /// `None`: all 1, except filling.
    pub(crate) weights: Option<Vec<f32>>,
    /// Sum of the weights of each row; 0 for rows of filling.
    pub(crate) diagonal: Vec<f32>,
    /// Rows that are not filling.
    pub(crate) occupied_rows: usize,
    /// Entries that bundles refer to.
    pub(crate) entries: usize,
    /// First row of a bundle of nothing but filling: that which entries of filling lead to.
    pub(crate) filling_row: u32,
    /// First row of each block, and the end of the last one.
    pub(crate) blocks: Vec<u32>,
    /// First block of each colour, and the number of blocks.
    pub(crate) colours: Vec<u32>,
    /// The blocks that hold rows, neighbours near each other: passes that may take them in any order take this one, so that rows
    /// are still in a cache when neighbours read them. Appended ones come last.
    pub(crate) along_curve: Vec<u32>,
    /// Positions in the unit box, or empty.
    pub(crate) positions: Vec<Lanes>,
    /// Row of the next level that each row belongs to, or [`NO_ROW`]. Empty on the coarsest level.
    pub(crate) aggregates: Vec<u32>,
    /// Where the members of each row of the next level begin in `members`, and where they end.
    pub(crate) ranges: Vec<[u32; 2]>,
    /// Rows of this level by aggregate; the seed comes first. After a repair there are gaps.
    pub(crate) members: Vec<u32>,
    /// How the next level was chosen.
    pub(crate) grouping: AggregationRule,
}

/// Where the entries of a bundle stand.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SliceExtent {
    pub(crate) begin: u32,
    /// First entry that leads to a later row.
    pub(crate) middle: u32,
    pub(crate) end: u32,
}

impl HierarchyLevel {
    /// A copy with room to grow, made by all threads: most of what it costs is memory that is touched for the first time.
    pub(crate) fn clone_in_parallel(&self) -> Self {
        fn all<T: Copy + Send + Sync>(of: &[T]) -> Vec<T> {
            let mut copy = Vec::with_capacity(of.len() + of.len() / SLACK);
            copy.par_extend(of.par_iter().with_min_len(1 << 15).copied());
            copy
        }
        Self {
            bundles: all(&self.bundles),
            neighbours: all(&self.neighbours),
            weights: self.weights.as_deref().map(all),
            diagonal: all(&self.diagonal),
            positions: all(&self.positions),
            aggregates: all(&self.aggregates),
            ranges: all(&self.ranges),
            members: all(&self.members),
            along_curve: self.along_curve.clone(),
            blocks: self.blocks.clone(),
            colours: self.colours.clone(),
            ..*self
        }
    }

    /// Rows, those of filling included.
    pub(crate) fn rows(&self) -> usize {
        self.diagonal.len()
    }

    /// The row that entries of filling lead to. Its block, if any, holds filling only.
    pub(crate) fn filling(&self) -> u32 {
        self.filling_row
    }

    /// Where the entries of bundle `k` begin, where those to later rows begin, and where they end.
    #[inline(always)]
    pub(crate) fn slice_extent(&self, k: usize) -> (usize, usize, usize) {
        let SliceExtent { begin, middle, end } = self.bundles[k];
        (begin as usize, middle as usize, end as usize)
    }

    /// Neighbours of row `i` and their weights, without filling.
    #[inline(always)]
    pub(crate) fn row(&self, i: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let (begin, _, end) = self.slice_extent(i / SLICE_ROWS);
        let filling = self.filling();
        (begin + i % SLICE_ROWS..end)
            .step_by(SLICE_ROWS)
            .map(move |e| (self.neighbours[e], self.weight(e)))
            .filter(move |&(j, _)| j != filling)
            .map(|(j, w)| (j as usize, w))
    }

    /// Neighbours that passes read a little after those of bundle `k`, to prefetch their rows now. Nearer ones would
    /// come too late, and much further ones would be evicted.
    #[inline(always)]
    pub(crate) fn later_neighbours(&self, k: usize) -> impl Iterator<Item = usize> + '_ {
        /// Entries: two bundles or so.
        const AHEAD: usize = 96;
        let (begin, _, end) = self.slice_extent(k);
        let later = self.neighbours.get(begin + AHEAD..end + AHEAD).unwrap_or(&[]);
        later.iter().map(|&j| j as usize)
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
        self.occupied_rows
    }

    /// Undirected edges.
    pub(crate) fn edge_count(&self) -> usize {
        let filling = self.filling();
        let entries = |b: &SliceExtent| &self.neighbours[b.begin as usize..b.end as usize];
        let of_bundle = |b| entries(b).iter().filter(|&&j| j != filling).count();
        self.bundles.iter().map(of_bundle).sum::<usize>() / 2
    }

    /// Rows of block `b`.
    #[inline(always)]
    pub(crate) fn block(&self, b: usize) -> std::ops::Range<usize> {
        self.blocks[b] as usize..self.blocks[b + 1] as usize
    }

    /// Rows of this level that row `coarse` of the next one stands for.
    #[inline(always)]
    pub(crate) fn members_of(&self, coarse: usize) -> &[u32] {
        let [begin, end] = self.ranges[coarse];
        &self.members[begin as usize..end as usize]
    }

    /// Rows of the next level.
    pub(crate) fn coarse_rows(&self) -> usize {
        self.ranges.len()
    }

    pub(crate) fn byte_size(&self) -> usize {
        let words = 3 * self.bundles.len() + self.neighbours.len() + self.diagonal.len();
        let words = words + self.blocks.len() + self.along_curve.len() + self.colours.len() + self.aggregates.len();
        let words = words + 2 * self.ranges.len() + self.members.len();
        4 * (words + self.weights.as_ref().map_or(0, Vec::len)) + 16 * self.positions.len()
    }

    /// Stores which row of the next level each row belongs to. `ranks` and `coarse_ranks` are the rows that the rows of
    /// the two drafts became; `coarse_rows` is the number of rows of the next level, filling included.
    pub(crate) fn set_aggregates(
        &mut self,
        groups: &Aggregates,
        ranks: &[u32],
        coarse_ranks: &[u32],
        coarse_rows: usize,
        threads: Parallelism,
    ) {
        let n = ranks.len();
        let threads = threads.for_rows(n);
        self.aggregates = vec![NO_ROW; self.rows()];
        let aggregates = SharedRows::new(&mut self.aggregates);
        threads.for_each(0..piece_count(n, PIECE), |k| {
            for k in piece_rows(k, n, PIECE) {
                let group = groups.of_row[k];
                if group != NO_ROW {
                    // SAFETY: every row of the draft has its own row of the level; each is visited once.
                    unsafe { aggregates.set(ranks[k] as usize, coarse_ranks[group as usize]) };
                }
            }
        });
        let mut ranges = vec![[0u32; 2]; coarse_rows];
        for (group, &row) in coarse_ranks.iter().enumerate() {
            ranges[row as usize][1] = groups.members_of(group).len() as u32;
        }
        let mut end = 0;
        for range in &mut ranges {
            *range = [end, end + range[1]];
            end = range[1];
        }
        self.members = vec![0; groups.members.len()];
        let members = SharedRows::new(&mut self.members);
        threads.for_each(0..piece_count(coarse_ranks.len(), PIECE), |k| {
            for group in piece_rows(k, coarse_ranks.len(), PIECE) {
                let [begin, end] = ranges[coarse_ranks[group] as usize];
                // SAFETY: every group has its own row of the next level; each is visited once.
                let out = unsafe { <&mut [u32]>::rows(members, begin as usize..end as usize) };
                for (out, &i) in out.iter_mut().zip(groups.members_of(group)) {
                    *out = ranks[i as usize];
                }
            }
        });
        self.ranges = ranges;
        self.grouping = groups.grouping;
    }
}
