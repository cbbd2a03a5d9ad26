//! Equation (8)'s residual made from the frames of a pose, row by row, where it is needed.
//!
//! With d_ij = ½ (M_i + M_j)(p_i − p_j) a row of the residual is Σ w (d_ij − (x_i − x_j)). All that it wants of a neighbour is linear in M_j
//! and c_j = x_j − ½ M_j p_j, so that no product is formed for an edge:
//!
//! r_i = ½ M_i δ_i + ½ (Σ w (M_j − M_i)) p_i + Σ w (c_j − c_i), where δ_i = Σ w (p_i − p_j) is known once and for all.
//!
//! All of a row that its neighbours read stands in one line of a cache, in single precision. Positions of about unit size are
//! off by 3e-8 there, and so is a residual, whatever the solution is: it shows in a shape as some 1e-6 of its size at most.

use crate::build::level::HierarchyLevel;
use crate::lanes::{Lanes, NumberWork, SLICE_ROWS, WideLanes, eight_wide, per_lane, prefetch};
use crate::solve::patches::PatchMap;
use bytemuck::Zeroable;

/// A linear map by its columns, each with whatever number behind it.
pub type MapColumns = [[f32; 4]; 3];

/// What the neighbours of a row read of it, one line of a cache: the columns of M, each with a coordinate of c = x − ½ M p behind it,
/// and the present position x.
#[derive(Debug, Clone, Copy, Zeroable)]
#[repr(C, align(64))]
pub struct PoseRow([f32; NUMBERS]);

/// Numbers of a row; the last one is 0.
const NUMBERS: usize = 16;
/// Where the coordinates of c are.
const OFFSET: [usize; 3] = [3, 7, 11];
/// Where x begins.
const POSITION: usize = 12;

impl PoseRow {
    /// A row whose map is the identity; no position is shown yet.
    pub(crate) const IDENTITY: Self = Self([
        1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    ]);

    /// Replaces M (paper equation (8)'s s R), given column by column. What depends on it is valid again after the next
    /// positions.
    #[inline(always)]
    pub fn set_map(&mut self, map: &[f32; 9]) {
        for (out, column) in self.0.chunks_exact_mut(4).zip(map.as_chunks::<3>().0) {
            out[..3].copy_from_slice(column);
        }
    }

    /// M, column by column.
    #[inline(always)]
    pub fn map(&self) -> [f32; 9] {
        let m = &self.0;
        [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]]
    }

    /// The columns of M.
    #[inline(always)]
    pub(super) fn map_columns(&self) -> MapColumns {
        [four(&self.0, 0).0, four(&self.0, 4).0, four(&self.0, 8).0]
    }

    /// The columns of M, each with 0 in its fourth lane.
    #[inline(always)]
    pub(super) fn columns(&self) -> PatchMap {
        self.map_columns().map(|[x, y, z, _]| Lanes([x, y, z, 0.0]))
    }

    /// Replaces the columns of M, as [`PoseRow::set_map`].
    #[inline(always)]
    pub(super) fn set_columns(&mut self, columns: &PatchMap) {
        for (out, column) in self.0.chunks_exact_mut(4).zip(columns) {
            out[..3].copy_from_slice(&column.0[..3]);
        }
    }

    /// Replaces the columns of M, given as four numbers each, as [`PoseRow::set_map`].
    #[inline(always)]
    pub fn set_map_columns(&mut self, columns: &MapColumns) {
        for (out, column) in self.0.as_chunks_mut::<4>().0.iter_mut().zip(columns) {
            *out = *column;
        }
    }

    /// Replaces the present position and c.
    #[inline(always)]
    pub(super) fn show(&mut self, rest: Lanes, x: &WideLanes) {
        let [a, b, c] = self.map_columns();
        let (a, b, c) = (Lanes(a).to_wide(), Lanes(b).to_wide(), Lanes(c).to_wide());
        let p = rest.to_wide();
        let offset = per_lane(|k| x[k] - 0.5 * (a[k] * p[0] + b[k] * p[1] + c[k] * p[2]));
        for (at, offset) in OFFSET.into_iter().zip(Lanes::from_wide(offset).0) {
            self.0[at] = offset;
        }
        let [x, y, z, _] = *x;
        self.0[POSITION..].copy_from_slice(&Lanes::from_wide([x, y, z, 0.0]).0);
    }

    #[inline(always)]
    fn halves(&self) -> &[[f32; NUMBERS / 2]] {
        self.0.as_chunks().0
    }

    /// The present position; the fourth lane is 0.
    #[inline(always)]
    pub(super) fn position(&self) -> Lanes {
        four(&self.0, POSITION)
    }

    /// M e; the fourth lane is of no use.
    #[inline(always)]
    pub(super) fn turned(&self, e: Lanes) -> Lanes {
        turned(&self.0, e)
    }
}

/// Four numbers from `at` on.
#[inline(always)]
fn four(row: &[f32; NUMBERS], at: usize) -> Lanes {
    Lanes([row[at], row[at + 1], row[at + 2], row[at + 3]])
}

/// The columns times e; the fourth lane is of no use.
#[inline(always)]
fn turned(row: &[f32; NUMBERS], e: Lanes) -> Lanes {
    four(row, 0) * e.0[0] + four(row, 4) * e.0[1] + four(row, 8) * e.0[2]
}

/// What residuals are made from, in row order.
#[derive(Clone, Copy)]
pub(crate) struct FrameRows<'a> {
    pub(crate) rows: &'a [PoseRow],
    /// p of each row.
    pub(crate) rest: &'a [Lanes],
    /// δ of each row.
    pub(crate) laplacians: &'a [Lanes],
    /// What comes on top of right-hand sides, in the caller's units; empty where there is none.
    pub(crate) more: &'a [Lanes],
    /// What those units are multiplied by.
    pub(crate) scale: f32,
}

/// One row of equation (8), stiffness aside.
pub(super) struct PosedEquation {
    /// b − A x.
    pub(super) residual: Lanes,
    /// b.
    pub(super) rhs: Lanes,
}

/// See [`FrameRows::bundle_sums`].
struct BundleSums<'a, const WEIGHTED: bool> {
    rows: &'a [PoseRow],
    level: &'a HierarchyLevel,
    bundle: usize,
}

impl<const WEIGHTED: bool> NumberWork for BundleSums<'_, WEIGHTED> {
    type Output = [[f32; NUMBERS]; SLICE_ROWS];

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { rows, level, bundle } = self;
        let (begin, _, end) = level.slice_extent(bundle);
        let filling = level.filling();
        let neighbours = level.neighbours[begin..end].as_chunks::<SLICE_ROWS>().0;
        let weights = level.weights.as_deref().map_or(&[][..], |w| &w[begin..end]);
        let weights = &weights.as_chunks::<SLICE_ROWS>().0[..if WEIGHTED { neighbours.len() } else { 0 }];
        let mut all = [[0.0; NUMBERS]; SLICE_ROWS];
        for (d, sums) in all.iter_mut().enumerate() {
            let i = bundle * SLICE_ROWS + d;
            let here = rows[i].halves();
            let (mut low, mut high) = ([0.0; NUMBERS / 2], [0.0; NUMBERS / 2]);
            for (n, j) in neighbours.iter().enumerate() {
                // Filling that has no weight of 0 is the row itself, which has no difference to it.
                let j = if !WEIGHTED && j[d] == filling { i } else { j[d] as usize };
                let there = rows[j].halves();
                let w = if WEIGHTED { weights[n][d] } else { 1.0 };
                for c in 0..NUMBERS / 2 {
                    let difference = [there[0][c] - here[0][c], there[1][c] - here[1][c]];
                    low[c] += if WEIGHTED { difference[0] * w } else { difference[0] };
                    high[c] += if WEIGHTED { difference[1] * w } else { difference[1] };
                }
            }
            sums[..NUMBERS / 2].copy_from_slice(&low);
            sums[NUMBERS / 2..].copy_from_slice(&high);
        }
        all
    }
}

impl FrameRows<'_> {
    /// What comes on top of equation (8)'s right-hand side in a row, in inner units.
    pub(super) fn more_of(&self, row: usize) -> WideLanes {
        self.more
            .get(row)
            .map_or([0.0; 4], |more| (*more * self.scale).to_wide())
    }

    /// The right-hand side of one row.
    pub(crate) fn right_hand_side(&self, level: &HierarchyLevel, row: usize) -> WideLanes {
        let here = self.rest[row];
        let mut others = Lanes::ZERO;
        for (j, w) in level.row(row) {
            others += self.rows[j].turned((here - self.rest[j]) * w);
        }
        let mut b = (self.rows[row].turned(self.laplacians[row]) + others) * 0.5;
        b.0[3] = 0.0;
        self.with_more(row, b).to_wide()
    }

    #[inline(always)]
    fn with_more(&self, row: usize, b: Lanes) -> Lanes {
        match self.more.get(row) {
            Some(more) => b + *more * self.scale,
            None => b,
        }
    }

    /// Σ w (row j − row i) over the neighbours j of each row i of bundle `k`, number by number.
    ///
    /// Not inlined: where the compiler sees what the sums are for it forms them number by number too.
    #[inline(never)]
    fn bundle_sums<const WEIGHTED: bool>(&self, level: &HierarchyLevel, k: usize) -> [[f32; NUMBERS]; SLICE_ROWS] {
        // Those of this bundle have been asked for already.
        level.later_neighbours(k).for_each(|j| prefetch(self.rows, j));
        eight_wide(BundleSums::<WEIGHTED> {
            rows: self.rows,
            level,
            bundle: k,
        })
    }

    /// The equations of the rows of bundle `k`.
    #[inline(always)]
    pub(super) fn equations<const WEIGHTED: bool>(
        &self,
        level: &HierarchyLevel,
        k: usize,
    ) -> [PosedEquation; SLICE_ROWS] {
        let sums = self.bundle_sums::<WEIGHTED>(level, k);
        let first = k * SLICE_ROWS;
        // One after the other: `array::from_fn` calls its closure instead of taking it in.
        [
            self.equation(first, &sums[0]),
            self.equation(first + 1, &sums[1]),
            self.equation(first + 2, &sums[2]),
            self.equation(first + 3, &sums[3]),
        ]
    }

    /// The equation of row `i` from its sums.
    #[inline(always)]
    fn equation(&self, i: usize, sums: &[f32; NUMBERS]) -> PosedEquation {
        let turned = self.rows[i].turned(self.laplacians[i]) + turned(sums, self.rest[i]);
        let [x, y, z] = OFFSET;
        let mut residual = turned * 0.5 + Lanes([sums[x], sums[y], sums[z], 0.0]);
        residual.0[3] = 0.0;
        let residual = self.with_more(i, residual);
        PosedEquation {
            residual,
            rhs: residual - four(sums, POSITION),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::BoxLattice;

    #[test]
    fn sums_have_the_same_bits_in_instructions_of_any_width() {
        fn compare<const WEIGHTED: bool>(level: &HierarchyLevel, rows: &[PoseRow]) {
            for bundle in 0..level.rows() / SLICE_ROWS {
                let sums = || BundleSums::<WEIGHTED> { rows, level, bundle };
                let (wide, narrow) = (eight_wide(sums()), sums().run());
                let bits = |sums: [[f32; NUMBERS]; SLICE_ROWS]| sums.map(|row| row.map(f32::to_bits));
                assert_eq!(bits(wide), bits(narrow), "bundle {bundle}");
                // And they are those of the neighbours, one after the other.
                for (d, found) in narrow.iter().enumerate() {
                    let i = bundle * SLICE_ROWS + d;
                    let mut expected = [0.0f64; NUMBERS];
                    for (j, w) in level.row(i) {
                        for (c, sum) in expected.iter_mut().enumerate() {
                            *sum += f64::from(w) * (f64::from(rows[j].0[c]) - f64::from(rows[i].0[c]));
                        }
                    }
                    let near = |(found, expected): (&f32, &f64)| (f64::from(*found) - expected).abs() < 1e-2;
                    assert!(found.iter().zip(&expected).all(near), "{found:?} against {expected:?}");
                }
            }
        }
        for weighted in [false, true] {
            let block = BoxLattice::new(9, 7, 8);
            let block = if weighted { block.weighted() } else { block };
            let hierarchy = block.hierarchy(60);
            let level = &hierarchy.levels[0];
            let number = |i: usize, c: usize| libm::sinf((i * NUMBERS + c) as f32 * 0.7);
            let row = |i: usize| match hierarchy.order[i] {
                crate::lanes::NO_ROW => PoseRow::IDENTITY,
                _ => PoseRow(std::array::from_fn(|c| number(i, c))),
            };
            let rows: Vec<PoseRow> = (0..level.rows()).map(row).collect();
            match weighted {
                true => compare::<true>(level, &rows),
                false => compare::<false>(level, &rows),
            }
        }
    }
}
