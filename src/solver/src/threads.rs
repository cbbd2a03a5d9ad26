//! Loops that run in parallel where that pays and give the same bits where it does not.

use std::ops::Range;

use rayon::prelude::*;

use pliant_exec::pool::Pool;

/// Whether loops may use more than one thread. Every loop below writes disjoint outputs, so the answer never shows in
/// the results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Parallelism {
    is_parallel: bool,
}

/// Rows below which starting other threads costs more than it saves. Miri has to see threads at work on graphs that it can finish.
const WORTHWHILE: usize = if cfg!(miri) { 64 } else { 8192 };

impl Parallelism {
    pub(crate) fn from_pool(pool: &Pool) -> Self {
        Self {
            is_parallel: pool.threads() > 1,
        }
    }

    /// This thread alone.
    pub(crate) fn single_threaded() -> Self {
        Self { is_parallel: false }
    }

    /// True if loops may use more than one thread.
    pub(crate) fn parallel(self) -> bool {
        self.is_parallel
    }

    /// The same for work over `rows` rows: small work stays on one thread.
    pub(crate) fn for_rows(self, rows: usize) -> Self {
        Self {
            is_parallel: self.is_parallel && rows >= WORTHWHILE,
        }
    }

    /// Runs `work` so that its loops use `pool`; without other threads it runs right here.
    pub(crate) fn run_on<R: Send>(self, pool: &Pool, work: impl FnOnce() -> R + Send) -> R {
        if self.is_parallel { pool.install(work) } else { work() }
    }

    /// Calls `body` for every number of `range`, in any order.
    #[inline]
    pub(crate) fn for_each(self, range: Range<usize>, body: impl Fn(usize) + Sync + Send) {
        if self.is_parallel && range.len() > 1 {
            range.into_par_iter().with_min_len(4).for_each(body);
        } else {
            range.for_each(body);
        }
    }

    /// Calls `body` for every number of `range` with scratch that `scratch` makes once per piece of work; results in
    /// the order of the range.
    pub(crate) fn map<S, R: Send>(
        self,
        range: Range<usize>,
        scratch: impl Fn() -> S + Sync + Send,
        body: impl Fn(&mut S, usize) -> R + Sync + Send,
    ) -> Vec<R> {
        if self.is_parallel && range.len() > 1 {
            range.into_par_iter().with_min_len(4).map_init(scratch, body).collect()
        } else {
            let mut s = scratch();
            range.map(|i| body(&mut s, i)).collect()
        }
    }

    /// Calls `body` with the number of the first row and the rows of each piece of `size` rows, in any order.
    #[inline]
    pub(crate) fn for_each_piece<V: PieceVectors>(
        self,
        size: usize,
        vectors: V,
        body: impl Fn(usize, V) + Sync + Send,
    ) {
        if self.is_parallel && vectors.row_count() > size {
            let pieces = vectors.parallel_pieces(size).with_min_len(4).enumerate();
            pieces.for_each(|(k, piece)| body(k * size, piece));
        } else {
            let pieces = vectors.pieces(size).enumerate();
            pieces.for_each(|(k, piece)| body(k * size, piece));
        }
    }

    /// The same with scratch that `scratch` makes once per share of the pieces; results in the order of the pieces.
    pub(crate) fn map_pieces<V: PieceVectors, S, R: Send>(
        self,
        size: usize,
        vectors: V,
        scratch: impl Fn() -> S + Sync + Send,
        body: impl Fn(&mut S, usize, V) -> R + Sync + Send,
    ) -> Vec<R> {
        if self.is_parallel && vectors.row_count() > size {
            let pieces = vectors.parallel_pieces(size).with_min_len(4).enumerate();
            let body = |s: &mut S, (k, piece): (usize, V)| body(s, k * size, piece);
            pieces.map_init(scratch, body).collect()
        } else {
            let mut s = scratch();
            let pieces = vectors.pieces(size).enumerate();
            pieces.map(|(k, piece)| body(&mut s, k * size, piece)).collect()
        }
    }

    /// Calls `body` with the number and the value of each of `items`, in any order, with scratch that `scratch` makes once per
    /// share of the items.
    pub(crate) fn for_each_item<T: Send, S>(
        self,
        items: Vec<T>,
        scratch: impl Fn() -> S + Sync + Send,
        body: impl Fn(&mut S, usize, T) + Sync + Send,
    ) {
        if self.is_parallel && items.len() > 1 {
            let items = items.into_par_iter().with_min_len(4).enumerate();
            items.for_each_init(scratch, |s, (k, item)| body(s, k, item));
        } else {
            let mut s = scratch();
            let items = items.into_iter().enumerate();
            items.for_each(|(k, item)| body(&mut s, k, item));
        }
    }

    /// Joins what `body` returns for 0, 1, … `count` − 1, always in this order. One thread needs no memory for that.
    pub(crate) fn fold_in_order<T: Send>(
        self,
        count: usize,
        zero: T,
        body: impl Fn(usize) -> T + Sync + Send,
        join: impl Fn(T, T) -> T,
    ) -> T {
        if self.is_parallel {
            let parts = self.map(0..count, || (), |(), k| body(k));
            parts.into_iter().fold(zero, join)
        } else {
            (0..count).fold(zero, |sum, k| join(sum, body(k)))
        }
    }
}

/// Vectors of as many elements that are cut into pieces of equal numbers of rows, the last piece shorter.
pub(crate) trait PieceVectors: Sized + Send {
    /// Number of rows.
    fn row_count(&self) -> usize;
    /// The pieces of `size` rows.
    fn pieces(self, size: usize) -> impl Iterator<Item = Self>;
    /// The same for several threads.
    fn parallel_pieces(self, size: usize) -> impl IndexedParallelIterator<Item = Self>;
}

impl<T: Send> PieceVectors for &mut [T] {
    fn row_count(&self) -> usize {
        self.len()
    }

    #[inline]
    fn pieces(self, size: usize) -> impl Iterator<Item = Self> {
        self.chunks_mut(size)
    }

    #[inline]
    fn parallel_pieces(self, size: usize) -> impl IndexedParallelIterator<Item = Self> {
        self.par_chunks_mut(size)
    }
}

impl<A: PieceVectors, B: PieceVectors> PieceVectors for (A, B) {
    fn row_count(&self) -> usize {
        debug_assert!(self.0.row_count() == self.1.row_count());
        self.0.row_count()
    }

    #[inline]
    fn pieces(self, size: usize) -> impl Iterator<Item = Self> {
        self.0.pieces(size).zip(self.1.pieces(size))
    }

    #[inline]
    fn parallel_pieces(self, size: usize) -> impl IndexedParallelIterator<Item = Self> {
        self.0.parallel_pieces(size).zip(self.1.parallel_pieces(size))
    }
}

/// Cuts `rows` into consecutive parts of `lengths`.
pub(crate) fn cut<T>(mut rows: &mut [T], lengths: impl Iterator<Item = usize>) -> Vec<&mut [T]> {
    lengths
        .map(|length| {
            let (part, rest) = std::mem::take(&mut rows).split_at_mut(length);
            rows = rest;
            part
        })
        .collect()
}

/// Splits `len` rows into pieces of `size`, the last one shorter: the fixed partition that loops without blocks use.
pub(crate) fn piece_count(len: usize, size: usize) -> usize {
    len.div_ceil(size)
}

/// Rows of piece `k`.
pub(crate) fn piece_rows(k: usize, len: usize, size: usize) -> Range<usize> {
    k * size..((k + 1) * size).min(len)
}
