//! Equation (8)'s right-hand side made from the frames of a pose, row by row, where it is needed.
//!
//! With d_ij = ½ (M_i + M_j)(p_i − p_j) the right-hand side of row i is ½ (M_i Σ w e_ij + Σ w M_j e_ij), e_ij = p_i − p_j. A residual
//! reads the same neighbours, so both are made in one pass and the right-hand side is never stored.
//!
//! All of a row that its neighbours read stands in one line of a cache, in single precision. Positions of about unit size are
//! off by 3e-8 there, and so is a residual, whatever the solution is: it shows in a shape as some 1e-6 of its size at most.

use crate::build::level::HierarchyLevel;
use crate::lanes::{Lanes, WideLanes};
use crate::solve::patches::PatchMap;
use crate::storage::SLICE_ROWS;

/// What the neighbours of a row read of it, one line of a cache: the columns of M, the position at rest, the present position.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct PoseRow([f32; 16]);

impl PoseRow {
    /// A row without a vertex.
    pub(crate) const EMPTY: Self = Self([0.0; 16]);

    /// A row of a vertex that is at rest at `rest`.
    pub(crate) fn at_rest([x, y, z]: [f64; 3]) -> Self {
        let (x, y, z) = (x as f32, y as f32, z as f32);
        Self([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, x, y, z, x, y, z, 0.0])
    }

    /// Replaces the columns of M (paper equation (8)'s s R).
    #[inline(always)]
    pub fn set_map(&mut self, map: &[f32; 9]) {
        self.0[..9].copy_from_slice(map);
    }

    /// The columns of M.
    #[inline(always)]
    pub fn map(&self) -> [f32; 9] {
        let m = &self.0;
        [m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]]
    }

    /// The columns of M, each with 0 in its fourth lane.
    #[inline(always)]
    pub(super) fn columns(&self) -> PatchMap {
        let m = &self.0;
        [0, 3, 6].map(|k| Lanes([m[k], m[k + 1], m[k + 2], 0.0]))
    }

    /// Replaces the columns of M.
    #[inline(always)]
    pub(super) fn set_columns(&mut self, columns: &PatchMap) {
        for (out, column) in self.0.chunks_exact_mut(3).zip(columns) {
            out.copy_from_slice(&column.0[..3]);
        }
    }

    /// Replaces the present position.
    #[inline(always)]
    pub(super) fn set_position(&mut self, x: &WideLanes) {
        (0..3).for_each(|c| self.0[12 + c] = x[c] as f32);
    }

    /// Three numbers from `at` on; the fourth lane holds whatever follows.
    #[inline(always)]
    fn three(&self, at: usize) -> Lanes {
        let m = &self.0;
        Lanes([m[at], m[at + 1], m[at + 2], m[at + 3]])
    }

    /// The position at rest; the fourth lane is of no use.
    #[inline(always)]
    pub(super) fn rest(&self) -> Lanes {
        self.three(9)
    }

    /// The present position; the fourth lane is 0.
    #[inline(always)]
    pub(super) fn position(&self) -> Lanes {
        self.three(12)
    }

    /// M e; the fourth lane is of no use.
    #[inline(always)]
    pub(super) fn turned(&self, e: Lanes) -> Lanes {
        self.three(0) * e.0[0] + self.three(3) * e.0[1] + self.three(6) * e.0[2]
    }
}

/// What right-hand sides are made from, in row order.
#[derive(Clone, Copy)]
pub(crate) struct FrameRows<'a> {
    pub(crate) rows: &'a [PoseRow],
    /// What comes on top, in the caller's units; empty where there is none.
    pub(crate) more: &'a [Lanes],
    /// What those units are multiplied by.
    pub(crate) scale: f32,
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
        let here = self.rows[row].rest();
        let (mut edges, mut others) = (Lanes::ZERO, Lanes::ZERO);
        for (j, w) in level.row(row) {
            let e = (here - self.rows[j].rest()) * w;
            edges += e;
            others += self.rows[j].turned(e);
        }
        self.row_of_sums(row, edges, others).to_wide()
    }

    /// The right-hand side of a row from the sums over its neighbours.
    #[inline(always)]
    pub(super) fn row_of_sums(&self, row: usize, edges: Lanes, others: Lanes) -> Lanes {
        let mut b = (self.rows[row].turned(edges) + others) * 0.5;
        b.0[3] = 0.0;
        match self.more.get(row) {
            Some(more) => b + *more * self.scale,
            None => b,
        }
    }

    /// Sums over the neighbours of bundle `k`.
    #[inline(always)]
    pub(super) fn bundle_sums<const WEIGHTED: bool>(&self, level: &HierarchyLevel, k: usize) -> BundleSums {
        let (begin, _, end) = level.slice_extent(k);
        let first = k * SLICE_ROWS;
        let filling = level.filling();
        let rest: [Lanes; SLICE_ROWS] = std::array::from_fn(|d| self.rows[first + d].rest());
        let here: [Lanes; SLICE_ROWS] = std::array::from_fn(|d| self.rows[first + d].position());
        let mut sums = BundleSums::default();
        let neighbours = level.neighbours[begin..end].as_chunks::<SLICE_ROWS>().0;
        let weights = level.weights.as_deref().map_or(&[][..], |w| &w[begin..end]);
        let weights = weights.as_chunks::<SLICE_ROWS>().0;
        for (n, j) in neighbours.iter().enumerate() {
            for d in 0..SLICE_ROWS {
                // Filling has weight 0: to itself, a row has no difference.
                let j = if j[d] == filling { first + d } else { j[d] as usize };
                let row = &self.rows[j];
                let (mut e, mut flow) = (rest[d] - row.rest(), here[d] - row.position());
                if WEIGHTED {
                    let w = weights[n][d];
                    (e, flow) = (e * w, flow * w);
                }
                sums.edges[d] += e;
                sums.others[d] += row.turned(e);
                sums.flows[d] += flow;
            }
        }
        sums
    }
}

/// Sums over the neighbours of four rows.
#[derive(Default)]
pub(super) struct BundleSums {
    /// Σ w e; the fourth lane is of no use.
    pub(super) edges: [Lanes; SLICE_ROWS],
    /// Σ w M_j e; the fourth lane is of no use.
    pub(super) others: [Lanes; SLICE_ROWS],
    /// Σ w (x_i − x_j).
    pub(super) flows: [Lanes; SLICE_ROWS],
}
