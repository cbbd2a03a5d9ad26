//! Loops that run in parallel where that pays and give the same bits where it does not.

use std::ops::Range;

use rayon::prelude::*;

use crate::pool::Pool;

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

    /// The same with scratch that `scratch` makes once per piece of work.
    pub(crate) fn for_each_with<S>(
        self,
        range: Range<usize>,
        scratch: impl Fn() -> S + Sync + Send,
        body: impl Fn(&mut S, usize) + Sync + Send,
    ) {
        if self.is_parallel && range.len() > 1 {
            range.into_par_iter().with_min_len(4).for_each_init(scratch, body);
        } else {
            let mut s = scratch();
            range.for_each(|i| body(&mut s, i));
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
}

/// Splits `len` rows into pieces of `size`, the last one shorter: the fixed partition that loops without blocks use.
pub(crate) fn piece_count(len: usize, size: usize) -> usize {
    len.div_ceil(size)
}

/// Rows of piece `k`.
pub(crate) fn piece_rows(k: usize, len: usize, size: usize) -> Range<usize> {
    k * size..((k + 1) * size).min(len)
}
