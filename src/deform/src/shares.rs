//! By node, the holds that have a say there: how fields of many handles are kept, and what animations blend with.

use pliant_exec::pool::Pool;
use pliant_solver::prefetch;
use rayon::prelude::*;

/// Holds with a say, and their shares.
pub(crate) type ShareRow = Vec<(u32, f32)>;

/// By node, the holds that have a say there, with their shares.
#[derive(Debug, Clone, Default)]
pub(crate) struct SparseShares {
    /// Where each node's begin; one more at the end.
    first: Vec<u32>,
    shares: Vec<(u32, f32)>,
}

impl SparseShares {
    /// Those that `row` returns of each node, below 2³² in all.
    pub fn of_rows(nodes: usize, pool: &Pool, row: impl Fn(usize) -> ShareRow + Sync + Send) -> Self {
        const PIECE: usize = 4096;
        // By piece, so that a node needs no memory of its own.
        let pieces = pool.map(nodes.div_ceil(PIECE), 1, |piece| {
            let (mut lengths, mut shares) = (Vec::new(), Vec::new());
            for node in piece * PIECE..((piece + 1) * PIECE).min(nodes) {
                let some = row(node);
                lengths.push(some.len() as u32);
                shares.extend(some);
            }
            (lengths, shares)
        });
        let mut first = Vec::with_capacity(nodes + 1);
        first.push(0);
        let mut total = 0;
        for length in pieces.iter().flat_map(|piece| &piece.0) {
            total += length;
            first.push(total);
        }
        let mut shares = Vec::with_capacity(total as usize);
        pieces.into_iter().for_each(|piece| shares.extend(piece.1));
        Self { first, shares }
    }

    /// How many nodes there are.
    pub fn nodes(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    /// The shares at a node.
    #[inline]
    pub fn at(&self, node: usize) -> &[(u32, f32)] {
        match self.first.get(node..node.saturating_add(2)) {
            Some(&[first, end]) => &self.shares[first as usize..end as usize],
            _ => &[],
        }
    }

    /// The share of a hold at a node whose holds rise; 0 where it has none.
    pub fn share_of(&self, hold: usize, node: usize) -> f32 {
        let some = self.at(node);
        some.binary_search_by_key(&(hold as u32), |s| s.0)
            .map_or(0.0, |at| some[at].1)
    }

    /// By hold, the nodes where it has a say, rising, with its share there; for those of `holds` holds that `is_wanted` names.
    pub fn by_hold(&self, holds: usize, is_wanted: impl Fn(usize) -> bool) -> Vec<Vec<(u32, f32)>> {
        let mut counts = vec![0usize; holds];
        self.shares.iter().for_each(|s| counts[s.0 as usize] += 1);
        let counts = counts.into_iter().enumerate();
        let mut lists: Vec<Vec<(u32, f32)>> = counts
            .map(|(k, count)| Vec::with_capacity(if is_wanted(k) { count } else { 0 }))
            .collect();
        for node in 0..self.nodes() {
            for &(k, share) in self.at(node) {
                if is_wanted(k as usize) {
                    lists[k as usize].push((node as u32, share));
                }
            }
        }
        lists
    }

    /// Asks memory for the shares of a node.
    #[inline]
    pub fn prefetch(&self, node: usize) {
        if let Some(&at) = self.first.get(node) {
            prefetch(&self.shares, at as usize);
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.first.capacity() * 4 + self.shares.capacity() * size_of::<(u32, f32)>()
    }
}

/// Keeps of a row the largest shares, by rising hold, brought to the sum 1; what is left out comes to at most `least`, and holds in
/// `row` may stand in any order.
pub(crate) fn keep_largest(mut row: ShareRow, least: f32) -> ShareRow {
    row.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    let mut left_out = 0.0;
    let small = row.iter().take_while(|s| {
        left_out += s.1;
        left_out <= least
    });
    let small = small.count();
    row.drain(..small);
    row.sort_unstable_by_key(|s| s.0);
    let sum: f32 = row.iter().map(|s| s.1).sum();
    if sum > 0.0 {
        row.iter_mut().for_each(|s| s.1 = (s.1 / sum).min(1.0));
    }
    row
}

/// By item, what `value` returns with memory of the thread's own that `scratch` makes, in pieces of a fixed size.
pub(crate) fn map_with_scratch<S, T: Send>(
    count: usize,
    pool: &Pool,
    scratch: impl Fn() -> S + Sync,
    value: impl Fn(&mut S, usize) -> T + Sync,
) -> Vec<T> {
    const PIECE: usize = 32;
    let pieces = pool.install(|| {
        let pieces = (0..count.div_ceil(PIECE)).into_par_iter().map(|piece| {
            let mut own = scratch();
            let items = piece * PIECE..((piece + 1) * PIECE).min(count);
            items.map(|k| value(&mut own, k)).collect::<Vec<T>>()
        });
        pieces.collect::<Vec<Vec<T>>>()
    });
    pieces.into_iter().flatten().collect()
}
