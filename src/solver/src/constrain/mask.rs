//! Which rows of one level are solved for, and with which diagonal.
//!
//! Free components that nothing holds: no fixed vertex, no stiffness.
//!
//! Their equations determine the unknowns up to one constant per column, and have a solution only if the right-hand
//! sides sum to zero. The solver solves the projected equations and leaves the mean of the start as it is.

use crate::build::hierarchy::Hierarchy;
use crate::build::level::HierarchyLevel;
use crate::lanes::{Lanes, NO_ROW, WIDTH, WideLanes, add_wide};
use crate::threads::{Parallelism, piece_count, piece_rows};
use std::sync::atomic::{AtomicU64, Ordering};

/// Rows that one piece of work handles.
const PIECE: usize = 4096;

/// One level under constraints. The level's off-diagonal entries stay as they are; a constrained row is *masked*: its
/// unknown is 0 in every correction, which takes it out of the equations of its neighbours.
#[derive(Debug, Default)]
pub(crate) struct LevelMask {
    /// 1 / (Σ w + α) of rows that are solved for, 0 of masked ones.
    pub(crate) inverses: Vec<f32>,
    /// α of each row, or empty where it is 0 everywhere.
    pub(crate) alphas: Vec<f32>,
    /// Blocks that hold a row to solve for, in sweep order.
    pub(crate) active: Vec<u32>,
    /// Where the active blocks stand in `active`, in the order of the level's curve.
    pub(crate) along_curve: Vec<u32>,
    /// First of `active` for each colour, and their number.
    pub(crate) colours: Vec<u32>,
    /// Free rows that have a masked neighbour, one bit each.
    pub(crate) border: Vec<u64>,
}

impl LevelMask {
    #[inline(always)]
    pub(crate) fn free(&self, row: usize) -> bool {
        self.inverses[row] != 0.0
    }

    #[inline]
    pub(crate) fn alpha(&self, row: usize) -> f32 {
        self.alphas.get(row).copied().unwrap_or(0.0)
    }

    /// Fills in what follows from `inverses`.
    pub(crate) fn list_active(&mut self, level: &HierarchyLevel, threads: Parallelism) {
        const BLOCKS: usize = 256;
        let count = level.colours.last().map_or(0, |&end| end as usize);
        let is_active = |b: &u32| level.block(*b as usize).any(|i| self.free(i));
        let lists = threads.for_rows(level.rows()).map(
            0..piece_count(count, BLOCKS),
            || (),
            |(), k| {
                let blocks = piece_rows(k, count, BLOCKS);
                (blocks.start as u32..blocks.end as u32)
                    .filter(is_active)
                    .collect::<Vec<u32>>()
            },
        );
        self.active = lists.concat();
        let place = |b: &u32| self.active.binary_search(b).ok().map(|k| k as u32);
        self.along_curve = level.along_curve.iter().filter_map(place).collect();
        debug_assert!(self.along_curve.len() == self.active.len());
        let before = |&end: &u32| self.active.partition_point(|b| *b < end) as u32;
        self.colours = level.colours.iter().map(before).collect();
    }

    #[inline(always)]
    pub(crate) fn on_border(&self, row: usize) -> bool {
        self.border[row >> 6] >> (row & 63) & 1 == 1
    }

    /// Fills in `border`, from whichever side has fewer rows. Filling counts as neither.
    pub(crate) fn find_border(&mut self, level: &HierarchyLevel, threads: Parallelism) {
        let n = level.rows();
        let threads = threads.for_rows(n);
        let count = |k| piece_rows(k, n, PIECE).filter(|&i| self.free(i)).count();
        let free: usize = threads
            .map(0..piece_count(n, PIECE), || (), |(), k| count(k))
            .iter()
            .sum();
        let from_free = free < level.occupied() / 2;
        let border: Vec<AtomicU64> = (0..n.div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
        threads.for_each(0..piece_count(n, PIECE), |k| {
            for i in piece_rows(k, n, PIECE).filter(|&i| self.free(i) == from_free && level.connected(i)) {
                for (j, _) in level.row(i) {
                    if self.free(j) != from_free {
                        let row = if from_free { i } else { j };
                        // Bits are only ever set, so the order makes no difference.
                        border[row >> 6].fetch_or(1 << (row & 63), Ordering::Relaxed);
                    }
                }
            }
        });
        self.border = border.into_iter().map(AtomicU64::into_inner).collect();
    }

    pub(crate) fn byte_size(&self) -> usize {
        let words = self.inverses.len() + self.alphas.len() + 2 * self.active.len() + self.colours.len();
        4 * words + 8 * self.border.len()
    }
}

/// The mask of the level below `fine`. An aggregate without free members is masked. Another one sums α over its free
/// members, and the weights that tie these to masked rows ([`tie_share`]). Always from scratch: nothing accumulates over
/// changes of constraints.
pub(crate) fn mask_coarser_level(
    fine: &HierarchyLevel,
    coarse: &HierarchyLevel,
    fine_mask: &LevelMask,
    threads: Parallelism,
) -> LevelMask {
    let n = coarse.rows();
    let threads = threads.for_rows(fine.rows());
    let mut mask = LevelMask {
        inverses: vec![0.0; n],
        alphas: vec![0.0; n],
        ..LevelMask::default()
    };
    // 1 marks aggregates with free members until all of them are known.
    threads.for_each_piece(PIECE, mask.inverses.as_mut_slice(), |first, inverses| {
        for (row, inverse) in (first..).zip(inverses) {
            let free = fine.members_of(row).iter().any(|&i| fine_mask.free(i as usize));
            *inverse = f32::from(u8::from(free));
        }
    });
    let mut alphas = std::mem::take(&mut mask.alphas);
    threads.for_each_piece(PIECE, alphas.as_mut_slice(), |first, alphas| {
        for (row, alpha) in (first..).zip(alphas) {
            if !mask.free(row) {
                continue;
            }
            let mut sum = 0.0f64;
            for &i in fine.members_of(row) {
                let i = i as usize;
                if !fine_mask.free(i) {
                    continue;
                }
                sum += f64::from(fine_mask.alpha(i));
                if !fine_mask.on_border(i) {
                    continue;
                }
                for (j, w) in fine.row(i).filter(|&(j, _)| !fine_mask.free(j)) {
                    sum += f64::from(w) * f64::from(tie_share(fine, &mask, row, j));
                }
            }
            *alpha = sum as f32;
        }
    });
    mask.alphas = alphas;
    for (row, inverse) in mask.inverses.iter_mut().enumerate().filter(|(_, v)| **v != 0.0) {
        let diagonal = coarse.diagonal[row] + mask.alphas[row];
        *inverse = if diagonal > 0.0 { 1.0 / diagonal } else { 0.0 };
    }
    mask.list_active(coarse, threads);
    mask.find_border(coarse, threads);
    mask
}

/// How much of an edge from a free member of aggregate `row` to the masked row `j` becomes α of the aggregate.
///
/// All of it inside the aggregate. Nothing if `j`'s aggregate is masked: the coarse edge to it says it all. Otherwise
/// that aggregate moves in the coarse equations, and what the edge holds would be lost; it counts as much as crossing
/// edges do on average. Handles of a few vertices are held by such edges alone.
pub(crate) fn tie_share(fine: &HierarchyLevel, coarse_mask: &LevelMask, row: usize, j: usize) -> f32 {
    const CROSSING: f32 = 0.6;
    let aggregate = fine.aggregates[j];
    if aggregate == row as u32 {
        1.0
    } else if aggregate != NO_ROW && coarse_mask.free(aggregate as usize) {
        CROSSING
    } else {
        0.0
    }
}

/// The rows of the finest level that belong to floating components.
#[derive(Debug, Default)]
pub(crate) struct FloatingComponents {
    rows: Vec<u32>,
    /// End of each component in `rows`.
    ends: Vec<u32>,
}

impl FloatingComponents {
    /// Looks at the top of the hierarchy, where each component has shrunk to a few rows, and only expands those found.
    pub(crate) fn find(
        hierarchy: &Hierarchy,
        masks: &[LevelMask],
        stiffness: &[f64],
        dense_rows: &[u32],
    ) -> FloatingComponents {
        let mut floating = FloatingComponents::default();
        let last = masks.len() - 1;
        let finest = &hierarchy.levels[0];
        for row in 0..finest.rows() {
            let alone = !finest.connected(row);
            if last > 0 && alone && masks[0].free(row) && stiffness.get(row).is_none_or(|s| *s == 0.0) {
                floating.add(hierarchy, 0, vec![row as u32]);
            }
        }
        for l in 1..=last {
            let (level, mask, below) = (&hierarchy.levels[l], &masks[l], &masks[l - 1]);
            for row in 0..level.rows() {
                let alone = !level.connected(row);
                let members = hierarchy.levels[l - 1].members_of(row);
                if alone && !mask.free(row) && members.iter().any(|&i| below.free(i as usize)) {
                    floating.add(hierarchy, l, vec![row as u32]);
                }
            }
        }
        let (level, mask) = (&hierarchy.levels[last], &masks[last]);
        let mut seen = vec![false; level.rows()];
        for root in dense_rows.iter().copied() {
            if std::mem::replace(&mut seen[root as usize], true) {
                continue;
            }
            let mut part = vec![root];
            let mut held = false;
            let mut head = 0;
            while head < part.len() {
                let i = part[head] as usize;
                head += 1;
                held |= mask.alpha(i) > 0.0 || (last == 0 && stiffness.get(i).is_some_and(|s| *s > 0.0));
                for (j, _) in level.row(i) {
                    if !mask.free(j) {
                        held = true;
                    } else if !std::mem::replace(&mut seen[j], true) {
                        part.push(j as u32);
                    }
                }
            }
            if !held {
                floating.add(hierarchy, last, part);
            }
        }
        floating
    }

    /// Adds the component that `rows` of level `l` stand for.
    fn add(&mut self, hierarchy: &Hierarchy, l: usize, mut rows: Vec<u32>) {
        for level in hierarchy.levels[..l].iter().rev() {
            rows = rows
                .iter()
                .flat_map(|&row| level.members_of(row as usize))
                .copied()
                .collect();
        }
        rows.sort_unstable();
        self.rows.extend(rows);
        self.ends.push(self.rows.len() as u32);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    pub(crate) fn byte_size(&self) -> usize {
        4 * (self.rows.len() + self.ends.len())
    }

    fn components(&self) -> impl Iterator<Item = &[u32]> {
        let begins = std::iter::once(0).chain(self.ends.iter().copied());
        begins
            .zip(&self.ends)
            .map(|(begin, &end)| &self.rows[begin as usize..end as usize])
    }

    /// How much the squared norm of `v` shrinks when the means are taken out.
    pub(crate) fn mean_norms(&self, v: impl Fn(usize) -> WideLanes) -> WideLanes {
        let mut norms = [0.0; WIDTH];
        for rows in self.components() {
            let mut sum = [0.0; WIDTH];
            for &i in rows {
                add_wide(&mut sum, v(i as usize));
            }
            for c in 0..WIDTH {
                norms[c] += sum[c] * sum[c] / rows.len() as f64;
            }
        }
        norms
    }

    /// Takes the mean over each component out of `v`.
    pub(crate) fn remove_means(&self, v: &mut [Lanes]) {
        for rows in self.components() {
            let mut sum = [0.0; WIDTH];
            for &i in rows {
                add_wide(&mut sum, v[i as usize].to_wide());
            }
            let mean = Lanes::from_wide(sum.map(|s| s / rows.len() as f64));
            for &i in rows {
                v[i as usize] -= mean;
            }
        }
    }

    /// The same in double precision.
    pub(crate) fn remove_wide_means(&self, v: &mut [WideLanes]) {
        for rows in self.components() {
            let mut sum = [0.0; WIDTH];
            for &i in rows {
                add_wide(&mut sum, v[i as usize]);
            }
            let mean = sum.map(|s| s / rows.len() as f64);
            for &i in rows {
                for c in 0..WIDTH {
                    v[i as usize][c] -= mean[c];
                }
            }
        }
    }
}
