//! One group of up to four columns in double precision: scaling, residual, right-hand side.
//! Those of a pose, and the norms of both, are computed in one pass over the rows.

use std::ops::Range;

use crate::build::hierarchy::{Hierarchy, power_of_two_below};
use crate::constrain::system::LinearSystem;
use crate::error::Error;
use crate::lanes::{Lanes, RowVectors, WIDTH, WideLanes, add_wide};
use crate::lanes::{NO_ROW, SLICE_ROWS, resize_untouched};
use crate::solve::frame_rows::FrameRows;
use crate::solve::sweep::MaskedLevel;
use crate::threads::{Parallelism, piece_count, piece_rows};

/// Bundles whose right-hand sides are fetched together.
const FETCH: usize = 16;

/// Rows that one piece of work handles where there are no blocks.
const PIECE: usize = 4096;

/// Where right-hand sides come from.
#[derive(Clone, Copy)]
enum RightHandSide<'a> {
    /// In the caller's order and units.
    Given(&'a [f64]),
    /// Made from the frames of a pose when they are asked for.
    Posed(FrameRows<'a>),
}

/// The equations `A x = b` of a system for given right-hand sides; made by [`LinearSystem::equations`].
#[derive(Debug, Clone, Copy)]
pub struct LinearEquations<'a> {
    pub(crate) system: &'a LinearSystem,
    pub(crate) hierarchy: &'a Hierarchy,
    pub(crate) columns: usize,
    pub(crate) rhs: &'a [f64],
}

/// A group of columns of `A x = b`.
///
/// Inside, every column is divided by a power of two (its `unit`) so that all numbers are moderate whatever the
/// caller's units are; that loses nothing.
#[derive(Clone, Copy)]
pub(crate) struct ColumnGroup<'a> {
    pub(crate) hierarchy: &'a Hierarchy,
    pub(crate) system: &'a LinearSystem,
    pub(crate) threads: Parallelism,
    rhs: RightHandSide<'a>,
    columns: usize,
    first: usize,
    width: usize,
    /// The caller's value of an inner 1, per column.
    pub(crate) unit: WideLanes,
    rhs_factor: WideLanes,
}

impl<'a> ColumnGroup<'a> {
    /// Looks at the columns from `first` on. `given`: the free rows of `x` count too.
    ///
    /// # Errors
    /// [`Error::Invalid`] if a number that matters is not finite.
    pub(crate) fn new(
        equations: &LinearEquations<'a>,
        first: usize,
        x: &[f64],
        given: bool,
        threads: Parallelism,
    ) -> Result<Self, Error> {
        let LinearEquations {
            system,
            hierarchy,
            columns,
            rhs,
        } = *equations;
        let width = WIDTH.min(columns - first);
        let n = hierarchy.vertices();
        let threads = threads.for_rows(n);
        // Sums instead of maxima would overflow; a value that is not finite shows up as an infinite maximum.
        let most_of = |k: usize| {
            let mut most = [[0.0f64; WIDTH]; 2];
            for v in piece_rows(k, n, PIECE) {
                let fixed = system.is_fixed(v);
                let at = v * columns + first;
                for c in 0..width {
                    let size = |v: f64| if v.is_finite() { v.abs() } else { f64::INFINITY };
                    if !fixed {
                        most[0][c] = most[0][c].max(size(rhs[at + c]));
                    }
                    if fixed || given {
                        most[1][c] = most[1][c].max(size(x[at + c]));
                    }
                }
            }
            most
        };
        let larger =
            |a: [WideLanes; 2], b: [WideLanes; 2]| [0, 1].map(|k| std::array::from_fn(|c| a[k][c].max(b[k][c])));
        let most: [WideLanes; 2] = threads.fold_in_order(piece_count(n, PIECE), [[0.0; WIDTH]; 2], most_of, larger);
        let (mut unit, mut rhs_factor) = ([1.0; WIDTH], [1.0; WIDTH]);
        for c in 0..width {
            let most = |what: usize| most[what][c];
            for (what, name) in ["right-hand side", "start or fixed value"].into_iter().enumerate() {
                if most(what).is_infinite() {
                    return Err(Error::Invalid(format!(
                        "column {} of the {name} holds a number that is not finite",
                        first + c
                    )));
                }
            }
            unit[c] = power_of_two_below((most(0) * hierarchy.weight_scale).max(most(1)).min(f64::MAX));
            rhs_factor[c] = hierarchy.weight_scale / unit[c];
        }
        Ok(Self {
            hierarchy,
            system,
            threads,
            rhs: RightHandSide::Given(rhs),
            columns,
            first,
            width,
            unit,
            rhs_factor,
        })
    }

    /// The three coordinates of a pose, in the units of its rest positions.
    pub(crate) fn of_pose(
        hierarchy: &'a Hierarchy,
        system: &'a LinearSystem,
        threads: Parallelism,
        frames: FrameRows<'a>,
    ) -> Self {
        Self {
            hierarchy,
            system,
            threads: threads.for_rows(hierarchy.vertices()),
            rhs: RightHandSide::Posed(frames),
            columns: 3,
            first: 0,
            width: 3,
            unit: [1.0; WIDTH],
            rhs_factor: [hierarchy.weight_scale; WIDTH],
        }
    }

    /// The frames that right-hand sides are made from.
    pub(crate) fn frames(&self) -> Option<FrameRows<'a>> {
        match self.rhs {
            RightHandSide::Given(_) => None,
            RightHandSide::Posed(frames) => Some(frames),
        }
    }

    pub(crate) fn width(&self) -> usize {
        self.width
    }

    pub(crate) fn columns(&self) -> Range<usize> {
        self.first..self.first + self.width
    }

    /// A residual of column `c` of the group in the caller's units.
    pub(crate) fn outer_residual(&self, r: f64, c: usize) -> f64 {
        r / self.rhs_factor[c]
    }

    /// Right-hand side of a row.
    #[inline(always)]
    pub(crate) fn rhs(&self, row: usize) -> WideLanes {
        let given = match self.rhs {
            RightHandSide::Given(given) => given,
            RightHandSide::Posed(frames) => return frames.right_hand_side(&self.hierarchy.levels[0], row),
        };
        let at = self.hierarchy.order[row] as usize * self.columns + self.first;
        let f = &self.rhs_factor;
        match &given[at..at + self.width] {
            [a, b, c] => [a * f[0], b * f[1], c * f[2], 0.0],
            some => {
                let mut v = [0.0; WIDTH];
                for (v, (a, f)) in v.iter_mut().zip(some.iter().zip(f)) {
                    *v = a * f;
                }
                v
            }
        }
    }

    /// Copies `x` into row order; free rows become 0 unless `given`.
    pub(crate) fn load(&self, x: &[f64], given: bool, out: &mut Vec<WideLanes>) {
        let n = self.hierarchy.levels[0].rows();
        resize_untouched(out, n);
        let mask = &self.system.masks[0];
        self.threads.for_each_piece(PIECE, out.as_mut_slice(), |first, out| {
            for (i, out) in (first..).zip(out) {
                *out = [0.0; WIDTH];
                if self.hierarchy.order[i] != NO_ROW && (given || !mask.free(i)) {
                    let at = self.hierarchy.order[i] as usize * self.columns + self.first;
                    for c in 0..self.width {
                        out[c] = x[at + c] / self.unit[c];
                    }
                }
            }
        });
    }

    /// Writes free rows back in the caller's order and units: x + e · e_unit, or x alone.
    pub(crate) fn store(&self, x: &[WideLanes], e: Option<(&[Lanes], WideLanes)>, out: &mut [f64]) {
        let mask = &self.system.masks[0];
        for (i, &vertex) in self.hierarchy.order.iter().enumerate() {
            if mask.free(i) {
                let mut v = x[i];
                if let Some((e, e_unit)) = e {
                    let e = e[i].to_wide();
                    for c in 0..WIDTH {
                        v[c] += e[c] * e_unit[c];
                    }
                }
                let at = vertex as usize * self.columns + self.first;
                for c in 0..self.width {
                    out[at + c] = v[c] * self.unit[c];
                }
            }
        }
    }

    /// b − A x of every free row, handed to `convert` and written to `out`; masked rows get `convert` of 0, rows of
    /// inactive blocks are not touched. Returns the squared norms. Without `with_rhs`, b is 0.
    ///
    /// The products are taken of differences x_i − x_j, which keeps full precision for bodies far from the origin.
    pub(crate) fn residual<T: Copy + Send + Sync>(
        &self,
        x: &[WideLanes],
        with_rhs: bool,
        out: &mut [T],
        convert: impl Fn(WideLanes) -> T + Sync + Send,
    ) -> WideLanes {
        let mask = &self.system.masks[0];
        let stiffness = &self.system.stiffness;
        assert!(x.len() == self.hierarchy.levels[0].rows());
        self.norms(out, |rows, out| {
            let mut norms = [0.0; WIDTH];
            // The caller's rows lie far apart. Fetched by themselves, many are under way at a time.
            let mut fetched = [[0.0; WIDTH]; FETCH * SLICE_ROWS];
            for (n, (out, k)) in out
                .as_chunks_mut::<SLICE_ROWS>()
                .0
                .iter_mut()
                .zip(rows.start / SLICE_ROWS..)
                .enumerate()
            {
                if with_rhs && n % FETCH == 0 {
                    for (b, i) in fetched.iter_mut().zip(k * SLICE_ROWS..rows.end) {
                        *b = if mask.free(i) { self.rhs(i) } else { [0.0; WIDTH] };
                    }
                }
                let flows = self.flows(x, k);
                for (d, i) in (k * SLICE_ROWS..(k + 1) * SLICE_ROWS).enumerate() {
                    let mut r = [0.0; WIDTH];
                    if mask.free(i) {
                        r = fetched[(n % FETCH) * SLICE_ROWS + d];
                        let s = stiffness.get(i).copied().unwrap_or(0.0);
                        for c in 0..WIDTH {
                            r[c] -= flows[d][c] + s * x[i][c];
                            norms[c] += r[c] * r[c];
                        }
                    }
                    out[d] = convert(r);
                }
            }
            norms
        })
    }

    /// Σ w (x_i − x_j) of the rows of bundle `k`.
    #[inline(always)]
    fn flows(&self, x: &[WideLanes], k: usize) -> [WideLanes; SLICE_ROWS] {
        let level = &self.hierarchy.levels[0];
        let (begin, _, end) = level.slice_extent(k);
        let first = k * SLICE_ROWS;
        let here: [WideLanes; SLICE_ROWS] = std::array::from_fn(|d| x[first + d]);
        let mut flows = [[0.0; WIDTH]; SLICE_ROWS];
        let neighbours = level.neighbours[begin..end].as_chunks::<SLICE_ROWS>().0;
        match &level.weights {
            None => {
                let filling = level.filling();
                for j in neighbours {
                    for d in 0..SLICE_ROWS {
                        // Filling has weight 0: to itself, a row has no difference.
                        let j = if j[d] == filling { first + d } else { j[d] as usize };
                        let there = x[j];
                        for c in 0..WIDTH {
                            flows[d][c] += here[d][c] - there[c];
                        }
                    }
                }
            }
            Some(w) => {
                for (j, w) in neighbours.iter().zip(w[begin..end].as_chunks::<SLICE_ROWS>().0) {
                    for d in 0..SLICE_ROWS {
                        let there = x[j[d] as usize];
                        for c in 0..WIDTH {
                            flows[d][c] += f64::from(w[d]) * (here[d][c] - there[c]);
                        }
                    }
                }
            }
        }
        flows
    }

    /// Squared norms of b, the right-hand side with the fixed values moved into it (β of the paper's equation (11)).
    pub(crate) fn rhs_norms(&self, x: &[WideLanes]) -> WideLanes {
        self.norms((), |rows, ()| {
            let mut norms = [0.0; WIDTH];
            for i in rows {
                let b = self.moved_rhs(x, i);
                for c in 0..WIDTH {
                    norms[c] += b[c] * b[c];
                }
            }
            norms
        })
    }

    /// The same, and b itself handed to `convert` and written to `out`: the residual of an `x` that is 0 on free rows.
    pub(crate) fn first_residual(
        &self,
        x: &[WideLanes],
        out: &mut [Lanes],
        convert: impl Fn(WideLanes) -> Lanes + Sync + Send,
    ) -> WideLanes {
        self.norms(out, |rows, out| {
            let mut norms = [0.0; WIDTH];
            for (i, out) in rows.zip(out) {
                let b = self.moved_rhs(x, i);
                for c in 0..WIDTH {
                    norms[c] += b[c] * b[c];
                }
                *out = convert(b);
            }
            norms
        })
    }

    /// b of row `i`, 0 if that is masked.
    #[inline(always)]
    fn moved_rhs(&self, x: &[WideLanes], i: usize) -> WideLanes {
        let mask = &self.system.masks[0];
        if !mask.free(i) {
            return [0.0; WIDTH];
        }
        let mut b = self.rhs(i);
        if mask.on_border(i) {
            self.move_given(x, i, &mut b);
        }
        b
    }

    /// Adds what given neighbours pull row `i` with.
    pub(crate) fn move_given(&self, x: &[WideLanes], i: usize, b: &mut WideLanes) {
        let (level, mask) = (&self.hierarchy.levels[0], &self.system.masks[0]);
        for (j, w) in level.row(i) {
            if !mask.free(j) {
                for c in 0..WIDTH {
                    b[c] += f64::from(w) * x[j][c];
                }
            }
        }
    }

    /// b − A x in double precision, floating components without their means; returns the squared norms.
    pub(crate) fn wide_residual(&self, x: &[WideLanes], r: &mut [WideLanes]) -> WideLanes {
        let norms = self.residual(x, true, r, |v| v);
        if self.system.floating.is_empty() {
            return norms;
        }
        self.system.floating.remove_wide_means(r);
        let r = &*r;
        self.norms((), |rows, ()| {
            let mut norms = [0.0; WIDTH];
            for r in &r[rows] {
                for c in 0..WIDTH {
                    norms[c] += r[c] * r[c];
                }
            }
            norms
        })
    }

    /// Adds up what `body` returns for the rows and the elements of `vectors` of each active block, always in the same
    /// order.
    pub(crate) fn norms<V: RowVectors>(
        &self,
        vectors: V,
        body: impl Fn(Range<usize>, V) -> WideLanes + Sync + Send,
    ) -> WideLanes {
        let [sum] = self.sums(vectors, |rows, parts| [body(rows, parts)]);
        sum
    }

    /// The same with several sums at once.
    pub(crate) fn sums<V: RowVectors, const N: usize>(
        &self,
        vectors: V,
        body: impl Fn(Range<usize>, V) -> [WideLanes; N] + Sync + Send,
    ) -> [WideLanes; N] {
        let add = |mut sums: [WideLanes; N], parts: [WideLanes; N]| {
            sums.iter_mut().zip(parts).for_each(|(sum, part)| add_wide(sum, part));
            sums
        };
        // A pose is near its floor of memory traffic: its rows are taken while they are still in a cache.
        let is_along_curve = self.frames().is_some();
        self.finest()
            .fold_blocks(is_along_curve, vectors, [[0.0; WIDTH]; N], body, add)
    }

    /// The finest level.
    pub(crate) fn finest(&self) -> MaskedLevel<'a> {
        MaskedLevel {
            level: &self.hierarchy.levels[0],
            mask: &self.system.masks[0],
            threads: self.threads,
        }
    }
}

/// b − A x of every row that is solved for, 0 of masked ones. Returns its squared norms, and those of b with the given values
/// moved into it.
pub(crate) fn posed_residual(
    problem: &ColumnGroup<'_>,
    frames: &FrameRows<'_>,
    x: &[WideLanes],
    out: &mut [Lanes],
) -> [WideLanes; 2] {
    let level = &problem.hierarchy.levels[0];
    let n = level.rows();
    assert!(x.len() == n && out.len() == n && frames.rows.len() == n);
    match &level.weights {
        None => residual_with::<false>(problem, frames, x, out),
        Some(_) => residual_with::<true>(problem, frames, x, out),
    }
}

fn residual_with<const WEIGHTED: bool>(
    problem: &ColumnGroup<'_>,
    frames: &FrameRows<'_>,
    x: &[WideLanes],
    out: &mut [Lanes],
) -> [WideLanes; 2] {
    let (level, mask) = (&problem.hierarchy.levels[0], &problem.system.masks[0]);
    let stiffness = &problem.system.stiffness;
    problem.sums(out, |rows, out| {
        let mut norms = [[0.0; WIDTH]; 2];
        let bundles = out.as_chunks_mut::<SLICE_ROWS>().0.iter_mut();
        for (out, k) in bundles.zip(rows.start / SLICE_ROWS..) {
            let equations = frames.equations::<WEIGHTED>(level, k);
            for ((out, equation), i) in out.iter_mut().zip(equations).zip(k * SLICE_ROWS..) {
                if !mask.free(i) {
                    *out = Lanes::ZERO;
                    continue;
                }
                let (mut r, b) = (equation.residual, equation.rhs);
                if let Some(s) = stiffness.get(i) {
                    r -= Lanes::from_wide(x[i]) * *s as f32;
                }
                *out = r;
                let (r, mut b) = (r.to_wide(), b.to_wide());
                if mask.on_border(i) {
                    problem.move_given(x, i, &mut b);
                }
                for c in 0..WIDTH {
                    norms[0][c] += r[c] * r[c];
                    norms[1][c] += b[c] * b[c];
                }
            }
        }
        norms
    })
}
