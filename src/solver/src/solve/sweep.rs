//! The passes over one level: Gauss–Seidel sweeps, residuals, restriction, prolongation.
//!
//! All vectors have one [`Lanes`] per row and hold 0 on masked rows. A cycle starts from zero, which halves the first
//! two passes: in the forward sweep the neighbours after a row are still 0, and the residual it leaves is made of just
//! these neighbours.
//!
//! Passes leave each other notes in a vector `t`, one entry per row:
//!
//! | pass | finds in `t` | leaves in `t` |
//! |---|---|---|
//! | `backward_after_forward` | nothing | D x before the row was swept back |
//! | `residual_after_both` | that | the residual |
//! | `residual` | nothing | the residual |
//! | `forward_full` | nothing | what the row saw of b and of the neighbours before it |
//! | `backward_from` | that | scratch |
//! | `backward` | nothing | with `keep` what `matrix_products` reads, else scratch |

use crate::build::level::HierarchyLevel;
use crate::constrain::mask::LevelMask;
use crate::lanes::{Lanes, NO_ROW, RowVectors, SLICE_ROWS, SharedRows, WIDTH, WideLanes, add_wide};
use crate::threads::Parallelism;

/// Rows of a vector pass without blocks.
const PIECE: usize = 1024;

/// A level under constraints, and the threads to use on it.
#[derive(Clone, Copy)]
pub(crate) struct MaskedLevel<'a> {
    pub(crate) level: &'a HierarchyLevel,
    pub(crate) mask: &'a LevelMask,
    pub(crate) threads: Parallelism,
}

/// Sums of one block: three inner products per lane.
pub(crate) type LaneDots = [Lanes; 3];

/// The vectors that a sweep or a cycle works on.
pub(crate) struct SweepVectors<'v> {
    /// The solution.
    pub(crate) x: &'v mut [Lanes],
    /// What each row saw of the right-hand side and of the neighbours before it.
    pub(crate) t: &'v mut [Lanes],
    /// Sums of the blocks, which inner products are made of.
    pub(crate) partials: &'v mut Vec<LaneDots>,
}

impl<'a> MaskedLevel<'a> {
    pub(crate) fn new(level: &'a HierarchyLevel, mask: &'a LevelMask, threads: Parallelism) -> Self {
        Self {
            level,
            mask,
            threads: threads.for_rows(level.rows()),
        }
    }

    /// Calls `body` with the number, the rows and the elements of `vectors` of every active block, in any order.
    #[inline]
    pub(crate) fn each_block<V: RowVectors>(
        &self,
        vectors: V,
        body: impl Fn(usize, std::ops::Range<usize>, V) + Sync + Send,
    ) {
        let along_curve = &self.mask.along_curve;
        let shared = vectors.share();
        self.threads.for_each(0..along_curve.len(), |p| {
            let k = along_curve[p] as usize;
            let rows = self.level.block(self.mask.active[k] as usize);
            // SAFETY: blocks are disjoint, and the curve visits each active one once.
            body(k, rows.clone(), unsafe { V::rows(shared, rows) });
        });
    }

    /// Adds up what `body` returns for each active block, always in the same order.
    pub(crate) fn sum_over_blocks<V: RowVectors>(
        &self,
        vectors: V,
        partials: &mut Vec<LaneDots>,
        body: impl Fn(std::ops::Range<usize>, V) -> LaneDots + Sync + Send,
    ) -> [WideLanes; 3] {
        self.sum_blocks::<_, false>(vectors, partials, body)
    }

    /// The same, in any order or as a backward sweep.
    #[inline]
    fn sum_blocks<V: RowVectors, const BACKWARD: bool>(
        &self,
        vectors: V,
        partials: &mut Vec<LaneDots>,
        body: impl Fn(std::ops::Range<usize>, V) -> LaneDots + Sync + Send,
    ) -> [WideLanes; 3] {
        partials.clear();
        partials.resize(self.mask.active.len(), [Lanes::ZERO; 3]);
        let shared = SharedRows::new(partials.as_mut_slice());
        // SAFETY: each block has a number of its own and is visited once.
        let sum = |k: usize, rows: std::ops::Range<usize>, parts: V| unsafe { shared.set(k, body(rows, parts)) };
        match BACKWARD {
            true => self.sweep(true, vectors, sum),
            false => self.each_block(vectors, sum),
        }
        sum_up(partials)
    }

    /// Joins what `body` returns for each active block, always in the same order: that of the curve, or else of memory.
    pub(crate) fn fold_blocks<V: RowVectors, T: Send>(
        &self,
        is_along_curve: bool,
        vectors: V,
        zero: T,
        body: impl Fn(std::ops::Range<usize>, V) -> T + Sync + Send,
        join: impl Fn(T, T) -> T,
    ) -> T {
        let (active, along_curve) = (&self.mask.active, &self.mask.along_curve);
        let shared = vectors.share();
        let of_block = |p: usize| {
            let k = if is_along_curve { along_curve[p] as usize } else { p };
            let rows = self.level.block(active[k] as usize);
            // SAFETY: blocks are disjoint, and either order visits each active one once.
            body(rows.clone(), unsafe { V::rows(shared, rows) })
        };
        self.threads.fold_in_order(active.len(), zero, of_block, join)
    }

    /// Calls `body` with the number, the rows and the elements of `vectors` of every active block, colour by colour; with
    /// those of one colour in any order.
    #[inline]
    fn sweep<V: RowVectors>(
        &self,
        backward: bool,
        vectors: V,
        body: impl Fn(usize, std::ops::Range<usize>, V) + Sync + Send,
    ) {
        let colours = self.mask.colours.len() - 1;
        let shared = vectors.share();
        for c in 0..colours {
            let c = if backward { colours - 1 - c } else { c };
            self.threads
                .for_each(self.mask.colours[c] as usize..self.mask.colours[c + 1] as usize, |k| {
                    let rows = self.level.block(self.mask.active[k] as usize);
                    // SAFETY: blocks are disjoint, and each active one has one colour.
                    body(k, rows.clone(), unsafe { V::rows(shared, rows) });
                });
        }
    }

    /// x = (D − L)⁻¹ b, where L holds the entries before the diagonal: a forward sweep from x = 0.
    pub(crate) fn forward(&self, b: &[Lanes], x: &mut [Lanes]) {
        match &self.level.weights {
            None => self.forward_with(b, x, &UnitWeights),
            Some(w) => self.forward_with(b, x, &StoredWeights(w)),
        }
    }

    fn forward_with<W: SliceWeights>(&self, b: &[Lanes], x: &mut [Lanes], w: &W) {
        let (level, inverses) = (self.level, &self.mask.inverses);
        assert!(b.len() == level.rows() && x.len() == level.rows() && inverses.len() == level.rows());
        let x = SharedRows::new(x);
        self.sweep(false, (), |_, rows, ()| {
            for k in rows.start / SLICE_ROWS..rows.end / SLICE_ROWS {
                let (begin, middle, _) = level.slice_extent(k);
                // SAFETY: neighbours are rows of the level; those read lie in this block or in one of a colour that
                // no thread writes now, or hold filling, which no thread writes; the bundle is written by the one thread
                // that sweeps its block.
                unsafe {
                    let sums = w.gather(&level.neighbours, x, begin, middle);
                    let rows = k * SLICE_ROWS..(k + 1) * SLICE_ROWS;
                    let (b, inverses) = (&b[rows.clone()], &inverses[rows.clone()]);
                    for (d, i) in rows.enumerate() {
                        x.set(i, (b[d] + sums[d]) * inverses[d]);
                    }
                }
            }
        });
    }

    /// The residual that the forward sweep leaves.
    pub(crate) fn residual(&self, x: &[Lanes], r: &mut [Lanes]) {
        match &self.level.weights {
            None => self.residual_with(x, r, &UnitWeights),
            Some(w) => self.residual_with(x, r, &StoredWeights(w)),
        }
    }

    fn residual_with<W: SliceWeights>(&self, x: &[Lanes], r: &mut [Lanes], w: &W) {
        let (level, mask) = (self.level, self.mask);
        assert!(x.len() == level.rows());
        self.each_block(r, |_, rows, out| {
            for (out, k) in out
                .as_chunks_mut::<SLICE_ROWS>()
                .0
                .iter_mut()
                .zip(rows.start / SLICE_ROWS..)
            {
                let (_, middle, end) = level.slice_extent(k);
                // SAFETY: neighbours are rows of the level, and no thread writes x now.
                let sums = unsafe { w.gather(&level.neighbours, ReadOnlyRows(x), middle, end) };
                for d in 0..SLICE_ROWS {
                    out[d] = sums[d].masked_by(mask.free(k * SLICE_ROWS + d));
                }
            }
        });
    }

    /// The backward sweep that makes a forward sweep from zero symmetric. The neighbours before a row have not changed
    /// since that was swept, and D x_i says what it saw of them: only those after it are read. `t` receives D x_i.
    pub(crate) fn backward_after_forward(&self, x: &mut [Lanes], t: &mut [Lanes]) {
        match &self.level.weights {
            None => self.backward_after_forward_with(x, t, &UnitWeights),
            Some(w) => self.backward_after_forward_with(x, t, &StoredWeights(w)),
        }
    }

    fn backward_after_forward_with<W: SliceWeights>(&self, x: &mut [Lanes], t: &mut [Lanes], w: &W) {
        let (level, mask) = (self.level, self.mask);
        assert!(x.len() == level.rows());
        let x = SharedRows::new(x);
        self.sweep(true, t, |_, rows, t| {
            let first = rows.start;
            for k in (rows.start / SLICE_ROWS..rows.end / SLICE_ROWS).rev() {
                let (_, middle, end) = level.slice_extent(k);
                // SAFETY: as in the forward sweep.
                unsafe {
                    let after = w.gather(&level.neighbours, x, middle, end);
                    for (d, i) in (k * SLICE_ROWS..(k + 1) * SLICE_ROWS).enumerate() {
                        let seen = x.get(i) * (level.diagonal[i] + mask.alpha(i));
                        t[i - first] = seen;
                        x.set(i, (seen + after[d]) * mask.inverses[i]);
                    }
                }
            }
        });
    }

    /// The residual that these two sweeps leave: only the neighbours before a row have changed since it was swept. `t`
    /// holds D x_i as of then, and receives the residual.
    pub(crate) fn residual_after_both(&self, b: &[Lanes], x: &[Lanes], t: &mut [Lanes]) {
        assert!(b.len() == self.level.rows());
        self.each_block(t, |_, rows, t| {
            let b = b[rows.clone()].as_chunks::<SLICE_ROWS>().0;
            for ((t, b), k) in t
                .as_chunks_mut::<SLICE_ROWS>()
                .0
                .iter_mut()
                .zip(b)
                .zip(rows.start / SLICE_ROWS..)
            {
                let product = self.matrix_products(x, t, k);
                for d in 0..SLICE_ROWS {
                    t[d] = (b[d] - product[d]).masked_by(self.mask.free(k * SLICE_ROWS + d));
                }
            }
        });
    }

    /// A full forward sweep on x. `t` receives what each row saw of b and of the neighbours before it.
    pub(crate) fn forward_full(&self, b: &[Lanes], x: &mut [Lanes], t: &mut [Lanes]) {
        match &self.level.weights {
            None => self.forward_full_with(b, x, t, &UnitWeights),
            Some(w) => self.forward_full_with(b, x, t, &StoredWeights(w)),
        }
    }

    fn forward_full_with<W: SliceWeights>(&self, b: &[Lanes], x: &mut [Lanes], t: &mut [Lanes], w: &W) {
        let (level, inverses) = (self.level, &self.mask.inverses);
        assert!(b.len() == level.rows() && x.len() == level.rows() && inverses.len() == level.rows());
        let x = SharedRows::new(x);
        self.sweep(false, t, |_, rows, t| {
            let first = rows.start;
            for k in rows.start / SLICE_ROWS..rows.end / SLICE_ROWS {
                let (begin, middle, end) = level.slice_extent(k);
                // SAFETY: as in the sweep from zero.
                unsafe {
                    let before = w.gather(&level.neighbours, x, begin, middle);
                    let after = w.gather(&level.neighbours, x, middle, end);
                    for (d, i) in (k * SLICE_ROWS..(k + 1) * SLICE_ROWS).enumerate() {
                        let seen = b[i] + before[d];
                        t[i - first] = seen;
                        x.set(i, (seen + after[d]) * inverses[i]);
                    }
                }
            }
        });
    }

    /// The backward sweep after [`MaskedLevel::forward_full`], which left `t`. Returns what [`MaskedLevel::backward`] returns.
    pub(crate) fn backward_from(&self, b: &[Lanes], vectors: SweepVectors<'_>, c: Option<&[Lanes]>) -> [WideLanes; 3] {
        match &self.level.weights {
            None => self.backward_from_with(b, vectors, c, &UnitWeights),
            Some(w) => self.backward_from_with(b, vectors, c, &StoredWeights(w)),
        }
    }

    fn backward_from_with<W: SliceWeights>(
        &self,
        b: &[Lanes],
        vectors: SweepVectors<'_>,
        c: Option<&[Lanes]>,
        w: &W,
    ) -> [WideLanes; 3] {
        let SweepVectors { x, t, partials } = vectors;
        let t = &*t;
        let (level, inverses) = (self.level, &self.mask.inverses);
        let (with_x, c) = (c.is_some(), c.unwrap_or(b));
        let n = level.rows();
        assert!(b.len() == n && c.len() == n && t.len() == n && x.len() == n && inverses.len() == n);
        let x = SharedRows::new(x);
        self.sum_blocks::<_, true>((), partials, |rows, ()| {
            let mut sums = [Lanes::ZERO; 3];
            for k in (rows.start / SLICE_ROWS..rows.end / SLICE_ROWS).rev() {
                let (_, middle, end) = level.slice_extent(k);
                // SAFETY: as in the forward sweep.
                unsafe {
                    let after = w.gather(&level.neighbours, x, middle, end);
                    for (d, i) in (k * SLICE_ROWS..(k + 1) * SLICE_ROWS).enumerate() {
                        let value = (t[i] + after[d]) * inverses[i];
                        x.set(i, value);
                        sums[0] += value * b[i];
                        sums[1] += value * (t[i] - after[d]);
                        sums[2] += if with_x { value } else { b[i] } * c[i];
                    }
                }
            }
            sums
        })
    }

    /// A full backward sweep on x. Returns (x, b), (x, A x) and (x, c), or (b, b) without `c`.
    ///
    /// With `keep`, `t` receives what each row saw of b and of the neighbours before it, from which
    /// [`MaskedLevel::matrix_products`] makes A x.
    /// With it, D x_i = t_i + (neighbours after i, final when i is swept), and (A x)_i = t_i − Σ_before w x_j. Every edge
    /// leads once to an earlier and once to a later row, so (x, A x) is also the sum of x_i (t_i − Σ_after w x_j): all
    /// inner products come with the sweep.
    pub(crate) fn backward(
        &self,
        b: &[Lanes],
        vectors: SweepVectors<'_>,
        keep: bool,
        c: Option<&[Lanes]>,
    ) -> [WideLanes; 3] {
        match (&self.level.weights, keep) {
            (None, false) => self.backward_with::<_, false>(b, vectors, c, &UnitWeights),
            (None, true) => self.backward_with::<_, true>(b, vectors, c, &UnitWeights),
            (Some(w), false) => self.backward_with::<_, false>(b, vectors, c, &StoredWeights(w)),
            (Some(w), true) => self.backward_with::<_, true>(b, vectors, c, &StoredWeights(w)),
        }
    }

    fn backward_with<W: SliceWeights, const KEEP: bool>(
        &self,
        b: &[Lanes],
        vectors: SweepVectors<'_>,
        c: Option<&[Lanes]>,
        w: &W,
    ) -> [WideLanes; 3] {
        let SweepVectors { x, t, partials } = vectors;
        let (level, inverses) = (self.level, &self.mask.inverses);
        let (with_x, c) = (c.is_some(), c.unwrap_or(b));
        let n = level.rows();
        assert!(b.len() == n && c.len() == n && x.len() == n && inverses.len() == n);
        let x = SharedRows::new(x);
        self.sum_blocks::<_, true>(t, partials, |rows, t| {
            let mut sums = [Lanes::ZERO; 3];
            let first = rows.start;
            for k in (rows.start / SLICE_ROWS..rows.end / SLICE_ROWS).rev() {
                let (begin, middle, end) = level.slice_extent(k);
                // SAFETY: as in the forward sweep.
                unsafe {
                    let before = w.gather(&level.neighbours, x, begin, middle);
                    let after = w.gather(&level.neighbours, x, middle, end);
                    let rows = k * SLICE_ROWS..(k + 1) * SLICE_ROWS;
                    let (b, c, inverses) = (&b[rows.clone()], &c[rows.clone()], &inverses[rows.clone()]);
                    for (d, i) in rows.enumerate() {
                        let before = b[d] + before[d];
                        let value = (before + after[d]) * inverses[d];
                        if KEEP {
                            t[i - first] = before;
                        }
                        x.set(i, value);
                        sums[0] += value * b[d];
                        sums[1] += value * (before - after[d]);
                        sums[2] += if with_x { value } else { b[d] } * c[d];
                    }
                }
            }
            sums
        })
    }

    /// A x of the rows of bundle `k`, from differences x_i − x_j: rounding stays relative to these, not to x.
    #[inline(always)]
    pub(crate) fn edge_flows(&self, x: &[Lanes], k: usize) -> [Lanes; SLICE_ROWS] {
        let level = self.level;
        assert!(x.len() == level.rows());
        let (begin, _, end) = level.slice_extent(k);
        let neighbours = level.neighbours[begin..end].as_chunks::<SLICE_ROWS>().0;
        let here: &[Lanes] = &x[k * SLICE_ROWS..(k + 1) * SLICE_ROWS];
        let here = [here[0], here[1], here[2], here[3]];
        // SAFETY: neighbours are rows of the level, and no thread writes x now.
        let there = |j: usize| unsafe { ReadOnlyRows(x).at(j) };
        let mut sums = [Lanes::ZERO; SLICE_ROWS];
        match &level.weights {
            None => {
                let filling = level.filling();
                for j in neighbours {
                    for d in 0..SLICE_ROWS {
                        // Filling has weight 0: to itself, a row has no difference.
                        let j = if j[d] == filling {
                            k * SLICE_ROWS + d
                        } else {
                            j[d] as usize
                        };
                        sums[d] += here[d] - there(j);
                    }
                }
            }
            Some(w) => {
                for (j, w) in neighbours.iter().zip(w[begin..end].as_chunks::<SLICE_ROWS>().0) {
                    for d in 0..SLICE_ROWS {
                        sums[d] += (here[d] - there(j[d] as usize)) * w[d];
                    }
                }
            }
        }
        for (d, sum) in sums.iter_mut().enumerate() {
            let i = k * SLICE_ROWS + d;
            *sum = (*sum + here[d] * self.mask.alpha(i)).masked_by(self.mask.free(i));
        }
        sums
    }

    /// A x of the rows of bundle `k`, from x and the `t` that [`MaskedLevel::backward`] left.
    #[inline(always)]
    pub(crate) fn matrix_products(&self, x: &[Lanes], t: &[Lanes; SLICE_ROWS], k: usize) -> [Lanes; SLICE_ROWS] {
        assert!(x.len() == self.level.rows());
        let (begin, middle, _) = self.level.slice_extent(k);
        let neighbours = &self.level.neighbours;
        // SAFETY: neighbours are rows of the level, and no thread writes x now.
        let before = unsafe {
            match &self.level.weights {
                None => UnitWeights.gather(neighbours, ReadOnlyRows(x), begin, middle),
                Some(w) => StoredWeights(w).gather(neighbours, ReadOnlyRows(x), begin, middle),
            }
        };
        let mut products = [Lanes::ZERO; SLICE_ROWS];
        for (d, product) in products.iter_mut().enumerate() {
            *product = (t[d] - before[d]).masked_by(self.mask.free(k * SLICE_ROWS + d));
        }
        products
    }

    /// Sums `r` over the members of each row of the next level.
    pub(crate) fn restrict(&self, r: &[Lanes], coarse: &mut [Lanes]) {
        let level = self.level;
        self.threads.for_each_piece(PIECE, coarse, |first, coarse| {
            for (row, out) in (first..).zip(coarse) {
                let mut sum = Lanes::ZERO;
                for &i in level.members_of(row) {
                    sum += r[i as usize];
                }
                *out = sum;
            }
        });
    }

    /// Adds to each free row the value of its aggregate.
    pub(crate) fn prolong(&self, coarse: &[Lanes], x: &mut [Lanes]) {
        let (level, mask) = (self.level, self.mask);
        self.each_block(x, |_, rows, x| {
            for (i, out) in rows.zip(x) {
                let aggregate = level.aggregates[i];
                if mask.free(i) && aggregate != NO_ROW {
                    *out += coarse[aggregate as usize];
                }
            }
        });
    }
}

/// Sums over all blocks, always in the same order.
fn sum_up(partials: &[LaneDots]) -> [WideLanes; 3] {
    let mut sums = [[0.0; WIDTH]; 3];
    for partial in partials {
        for (sum, p) in sums.iter_mut().zip(partial) {
            add_wide(sum, p.to_wide());
        }
    }
    sums
}

/// Weights of the entries of a level.
trait SliceWeights: Sync {
    /// Adds w x_j for entries `from..to` of one bundle to its four sums.
    ///
    /// # Safety
    /// The entries exist, and `x` can be read at all their neighbours.
    unsafe fn gather<X: RowVector>(&self, neighbours: &[u32], x: X, from: usize, to: usize) -> [Lanes; SLICE_ROWS];
}

/// All weights are 1 and none is stored; filling reads a row that holds 0.
struct UnitWeights;

impl SliceWeights for UnitWeights {
    #[inline(always)]
    unsafe fn gather<X: RowVector>(&self, neighbours: &[u32], x: X, from: usize, to: usize) -> [Lanes; SLICE_ROWS] {
        let mut sums = [Lanes::ZERO; SLICE_ROWS];
        for j in neighbours[from..to].as_chunks::<SLICE_ROWS>().0 {
            for d in 0..SLICE_ROWS {
                // SAFETY: by the caller's promise.
                sums[d] += unsafe { x.at(j[d] as usize) };
            }
        }
        sums
    }
}

/// One stored weight per entry.
struct StoredWeights<'a>(&'a [f32]);

impl SliceWeights for StoredWeights<'_> {
    #[inline(always)]
    unsafe fn gather<X: RowVector>(&self, neighbours: &[u32], x: X, from: usize, to: usize) -> [Lanes; SLICE_ROWS] {
        let mut sums = [Lanes::ZERO; SLICE_ROWS];
        let neighbours = neighbours[from..to].as_chunks::<SLICE_ROWS>().0;
        for (j, w) in neighbours.iter().zip(self.0[from..to].as_chunks::<SLICE_ROWS>().0) {
            for d in 0..SLICE_ROWS {
                // SAFETY: by the caller's promise.
                sums[d] += unsafe { x.at(j[d] as usize) } * w[d];
            }
        }
        sums
    }
}

/// A vector to gather from.
trait RowVector: Copy {
    /// Row `i`.
    ///
    /// # Safety
    /// The row exists and no thread writes it now.
    unsafe fn at(self, i: usize) -> Lanes;
}

impl RowVector for SharedRows<'_, Lanes> {
    #[inline(always)]
    unsafe fn at(self, i: usize) -> Lanes {
        // SAFETY: by the caller's promise.
        unsafe { self.get(i) }
    }
}

/// A read-only vector.
#[derive(Clone, Copy)]
struct ReadOnlyRows<'a>(&'a [Lanes]);

impl RowVector for ReadOnlyRows<'_> {
    #[inline(always)]
    unsafe fn at(self, i: usize) -> Lanes {
        debug_assert!(i < self.0.len());
        // SAFETY: by the caller's promise.
        unsafe { *self.0.get_unchecked(i) }
    }
}
