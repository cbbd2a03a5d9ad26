//! The passes over one level: Gauss–Seidel sweeps, residuals, restriction, prolongation.
//!
//! All vectors have one [`Lanes`] per row and hold 0 on masked rows. A cycle starts from zero, which halves the first
//! two passes: in the forward sweep the neighbours after a row are still 0, and the residual it leaves is made of just
//! these neighbours.

use super::lanes::{Lanes, Shared, WIDTH, Wide, add_wide};
use super::level::{Level, NONE};
use super::system::Mask;
use super::threads::{Threads, piece, pieces};

/// Rows of a vector pass without blocks.
const PIECE: usize = 1024;

/// A level under constraints, and the threads to use on it.
#[derive(Clone, Copy)]
pub(crate) struct Grid<'a> {
    pub(crate) level: &'a Level,
    pub(crate) mask: &'a Mask,
    pub(crate) threads: Threads,
}

/// Sums of one block: three inner products per lane.
pub(crate) type Dots = [Lanes; 3];

impl<'a> Grid<'a> {
    pub(crate) fn new(level: &'a Level, mask: &'a Mask, threads: Threads) -> Self {
        Self {
            level,
            mask,
            threads: threads.for_rows(level.rows()),
        }
    }

    /// Calls `body` with the number and the rows of every active block, in any order.
    #[inline]
    pub(crate) fn each_block(&self, body: impl Fn(usize, std::ops::Range<usize>) + Sync + Send) {
        self.threads.each(0..self.mask.active.len(), |k| {
            body(k, self.level.block(self.mask.active[k] as usize))
        });
    }

    /// Calls `body` for every active block, colour by colour; blocks of one colour in any order.
    #[inline]
    fn sweep(&self, backward: bool, body: impl Fn(std::ops::Range<usize>) + Sync + Send) {
        let colours = self.mask.colours.len() - 1;
        for c in 0..colours {
            let c = if backward { colours - 1 - c } else { c };
            self.threads
                .each(self.mask.colours[c] as usize..self.mask.colours[c + 1] as usize, |k| {
                    body(self.level.block(self.mask.active[k] as usize));
                });
        }
    }

    /// x = (D − L)⁻¹ b, where L holds the entries before the diagonal: a forward sweep from x = 0.
    pub(crate) fn forward(&self, b: &[Lanes], x: &mut [Lanes]) {
        match &self.level.weights {
            None => self.forward_with(b, x, &Unit),
            Some(w) => self.forward_with(b, x, &Values(w)),
        }
    }

    fn forward_with<W: Weight>(&self, b: &[Lanes], x: &mut [Lanes], w: &W) {
        let (level, inverses) = (self.level, &self.mask.inverses);
        assert!(b.len() == level.rows() && x.len() == level.rows());
        let x = Shared::new(x);
        self.sweep(false, |rows| {
            for i in rows {
                let (begin, middle, _) = level.entries(i);
                // SAFETY: neighbours are rows of the level; those read lie in this block or in one of a colour that
                // no thread writes now; row i is written by the one thread that sweeps its block.
                unsafe {
                    let sum = gather(level, w, x, begin, middle);
                    x.set(i, (b[i] + sum) * inverses[i]);
                }
            }
        });
    }

    /// The residual that the forward sweep leaves.
    pub(crate) fn residual(&self, x: &[Lanes], r: &mut [Lanes]) {
        match &self.level.weights {
            None => self.residual_with(x, r, &Unit),
            Some(w) => self.residual_with(x, r, &Values(w)),
        }
    }

    fn residual_with<W: Weight>(&self, x: &[Lanes], r: &mut [Lanes], w: &W) {
        let (level, mask) = (self.level, self.mask);
        assert!(x.len() == level.rows());
        let r = Shared::new(r);
        self.each_block(|_, rows| {
            // SAFETY: blocks are disjoint and each is visited once.
            let out = unsafe { r.rows(rows.clone()) };
            for (i, out) in rows.zip(out) {
                let (_, middle, end) = level.entries(i);
                *out = if mask.free(i) {
                    gather_slice(level, w, x, middle, end)
                } else {
                    Lanes::ZERO
                };
            }
        });
    }

    /// A full backward sweep on x. `t` receives what each row saw of b and of the neighbours before it, which
    /// [`Grid::apply`] turns into A x.
    pub(crate) fn backward(&self, b: &[Lanes], x: &mut [Lanes], t: &mut [Lanes]) {
        match &self.level.weights {
            None => self.backward_with(b, x, t, &Unit),
            Some(w) => self.backward_with(b, x, t, &Values(w)),
        }
    }

    fn backward_with<W: Weight>(&self, b: &[Lanes], x: &mut [Lanes], t: &mut [Lanes], w: &W) {
        let (level, inverses) = (self.level, &self.mask.inverses);
        assert!(b.len() == level.rows() && x.len() == level.rows());
        let (x, t) = (Shared::new(x), Shared::new(t));
        self.sweep(true, |rows| {
            let first = rows.start;
            // SAFETY: one thread sweeps this block.
            let t = unsafe { t.rows(rows.clone()) };
            for i in rows.rev() {
                let (begin, middle, end) = level.entries(i);
                // SAFETY: as in the forward sweep.
                unsafe {
                    let before = b[i] + gather(level, w, x, begin, middle);
                    let after = gather(level, w, x, middle, end);
                    t[i - first] = before;
                    x.set(i, (before + after) * inverses[i]);
                }
            }
        });
    }

    /// After [`Grid::backward`]: t becomes v = A x. Returns (x, a), (x, v) and (x, c), or (a, a) without `c`.
    ///
    /// When row i was swept, D x_i = t_i + (neighbours after it, final by then); only the neighbours before it have
    /// changed since, so (A x)_i = t_i − Σ_before w x_j.
    pub(crate) fn apply(
        &self,
        x: &[Lanes],
        t: &mut [Lanes],
        a: &[Lanes],
        c: Option<&[Lanes]>,
        partials: &mut Vec<Dots>,
    ) -> [Wide; 3] {
        match &self.level.weights {
            None => self.apply_with(x, t, a, c, partials, &Unit),
            Some(w) => self.apply_with(x, t, a, c, partials, &Values(w)),
        }
    }

    fn apply_with<W: Weight>(
        &self,
        x: &[Lanes],
        t: &mut [Lanes],
        a: &[Lanes],
        c: Option<&[Lanes]>,
        partials: &mut Vec<Dots>,
        w: &W,
    ) -> [Wide; 3] {
        let (level, mask) = (self.level, self.mask);
        assert!(x.len() == level.rows());
        let t = Shared::new(t);
        self.dots(partials, |rows| {
            // SAFETY: blocks are disjoint and each is visited once.
            let t = unsafe { t.rows(rows.clone()) };
            let mut sums = [Lanes::ZERO; 3];
            for (i, t) in rows.zip(t) {
                let (begin, middle, _) = level.entries(i);
                *t = if mask.free(i) {
                    *t - gather_slice(level, w, x, begin, middle)
                } else {
                    Lanes::ZERO
                };
                sums[0] += x[i] * a[i];
                sums[1] += x[i] * *t;
                sums[2] += match c {
                    Some(c) => x[i] * c[i],
                    None => a[i] * a[i],
                };
            }
            sums
        })
    }

    /// Adds up what `body` returns for each active block, always in the same order.
    pub(crate) fn dots(
        &self,
        partials: &mut Vec<Dots>,
        body: impl Fn(std::ops::Range<usize>) -> Dots + Sync + Send,
    ) -> [Wide; 3] {
        partials.clear();
        partials.resize(self.mask.active.len(), [Lanes::ZERO; 3]);
        let shared = Shared::new(partials.as_mut_slice());
        // SAFETY: element k is written by the one thread that visits block k.
        self.each_block(|k, rows| unsafe { shared.set(k, body(rows)) });
        let mut sums = [[0.0; WIDTH]; 3];
        for partial in partials.iter() {
            for (sum, p) in sums.iter_mut().zip(partial) {
                add_wide(sum, p.wide());
            }
        }
        sums
    }

    /// Sums `r` over the members of each row of the next level.
    pub(crate) fn restrict(&self, r: &[Lanes], coarse: &mut [Lanes]) {
        let level = self.level;
        let n = coarse.len();
        let out = Shared::new(coarse);
        self.threads.each(0..pieces(n, PIECE), |k| {
            let rows = piece(k, n, PIECE);
            // SAFETY: pieces are disjoint and each is visited once.
            let out = unsafe { out.rows(rows.clone()) };
            for (row, out) in rows.zip(out) {
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
        let x = Shared::new(x);
        self.each_block(|_, rows| {
            // SAFETY: blocks are disjoint and each is visited once.
            let out = unsafe { x.rows(rows.clone()) };
            for (i, out) in rows.zip(out) {
                let aggregate = level.aggregates[i];
                if mask.free(i) && aggregate != NONE {
                    *out += coarse[aggregate as usize];
                }
            }
        });
    }
}

/// Weight of an entry.
trait Weight: Sync {
    fn scale(&self, entry: usize, x: Lanes) -> Lanes;
}

/// All weights are 1 and none is stored.
struct Unit;

impl Weight for Unit {
    #[inline(always)]
    fn scale(&self, _: usize, x: Lanes) -> Lanes {
        x
    }
}

/// One stored weight per entry.
struct Values<'a>(&'a [f32]);

impl Weight for Values<'_> {
    #[inline(always)]
    fn scale(&self, entry: usize, x: Lanes) -> Lanes {
        x * self.0[entry]
    }
}

/// Σ w x_j over entries.
///
/// # Safety
/// No thread writes the neighbours' rows now, and all neighbours are rows of x.
#[inline(always)]
unsafe fn gather<W: Weight>(level: &Level, w: &W, x: Shared<'_, Lanes>, from: usize, to: usize) -> Lanes {
    let mut sum = Lanes::ZERO;
    for (e, &j) in (from..to).zip(&level.neighbours[from..to]) {
        // SAFETY: by the caller's promise.
        sum += w.scale(e, unsafe { x.get(j as usize) });
    }
    sum
}

/// Σ w x_j over entries of a vector that nobody writes.
#[inline(always)]
fn gather_slice<W: Weight>(level: &Level, w: &W, x: &[Lanes], from: usize, to: usize) -> Lanes {
    let mut sum = Lanes::ZERO;
    for (e, &j) in (from..to).zip(&level.neighbours[from..to]) {
        sum += w.scale(e, x[j as usize]);
    }
    sum
}
