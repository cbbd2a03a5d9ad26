//! The multigrid cycle that preconditions the outer iteration (paper section 5, Algorithm 1).

use crate::build::hierarchy::Hierarchy;
use crate::constrain::system::LinearSystem;
use crate::lanes::{Lanes, SLICE_ROWS, WIDTH, WideLanes, per_lane, ratio, resize_untouched};
use crate::solve::sweep::{LaneDots, MaskedLevel, SweepVectors};
use crate::threads::Parallelism;
use pliant_exec::progress::{Cancelled, Progress, check};

/// The second step of a K-cycle is left out once the first one has brought the squared residual down by this factor.
const ENOUGH: f64 = 1.0 / 16.0;

/// Vectors of one coarse level.
#[derive(Debug, Default)]
pub(crate) struct CoarseVectors {
    pub(crate) b: Vec<Lanes>,
    pub(crate) z: Vec<Lanes>,
    t: Vec<Lanes>,
    first_z: Vec<Lanes>,
    first_v: Vec<Lanes>,
    dense: Vec<WideLanes>,
    partials: Vec<LaneDots>,
}

impl CoarseVectors {
    /// Sizes the vectors for a level and clears what sweeps will read without having written it.
    pub(crate) fn prepare(&mut self, grid: &MaskedLevel<'_>) {
        let n = grid.level.rows();
        resize_untouched(&mut self.b, n);
        for v in [&mut self.z, &mut self.t, &mut self.first_z, &mut self.first_v] {
            resize_untouched(v, n);
            clear_inactive(grid, v);
        }
    }

    pub(crate) fn byte_size(&self) -> usize {
        let lanes = self.b.capacity() + self.z.capacity() + self.t.capacity();
        let lanes = lanes + self.first_z.capacity() + self.first_v.capacity() + 3 * self.partials.capacity();
        16 * lanes + 32 * self.dense.capacity()
    }
}

/// Sets the rows of inactive blocks to 0.
pub(crate) fn clear_inactive(grid: &MaskedLevel<'_>, v: &mut [Lanes]) {
    let mut active = grid.mask.active.iter().peekable();
    for b in 0..grid.level.blocks.len() - 1 {
        if active.next_if(|a| **a as usize == b).is_none() {
            v[grid.level.block(b)].fill(Lanes::ZERO);
        }
    }
    let filling = grid.level.filling() as usize;
    v[filling..filling + SLICE_ROWS].fill(Lanes::ZERO);
}

/// Runs cycles on a constrained hierarchy.
pub(crate) struct MultigridCycle<'a> {
    pub(crate) hierarchy: &'a Hierarchy,
    pub(crate) system: &'a LinearSystem,
    pub(crate) threads: Parallelism,
    pub(crate) progress: &'a dyn Progress,
}

impl<'a> MultigridCycle<'a> {
    pub(crate) fn grid(&self, l: usize) -> MaskedLevel<'a> {
        MaskedLevel::new(&self.hierarchy.levels[l], &self.system.masks[l], self.threads)
    }

    /// One cycle on level `l`: z ≈ A⁻¹ b, a symmetric operation but for the inner products of the K-cycle; for that the
    /// sweeps after the coarse correction mirror those before it. Returns
    /// (z, b), (z, A z) and (z, c), or (b, b) without `c`. `vectors` hold z; their `t` is scratch, on coarse levels left as
    /// [`MaskedLevel::matrix_products`] wants it. `below` holds the vectors of the coarser levels.
    pub(crate) fn run(
        &self,
        l: usize,
        b: &[Lanes],
        vectors: SweepVectors<'_>,
        c: Option<&[Lanes]>,
        below: &mut [CoarseVectors],
    ) -> Result<[WideLanes; 3], Cancelled> {
        let grid = self.grid(l);
        let SweepVectors { x: z, t, partials } = vectors;
        check(self.progress)?;
        let twice = l == 0 && self.system.twice;
        grid.forward(b, z);
        check(self.progress)?;
        if twice {
            grid.backward_after_forward(z, t);
            grid.residual_after_both(b, z, t);
        } else {
            grid.residual(z, t);
        }
        grid.restrict(t, &mut below[0].b);
        self.solve(l + 1, below)?;
        check(self.progress)?;
        grid.prolong(&below[0].z, z);
        if twice {
            grid.forward_full(b, z, t);
            check(self.progress)?;
            return Ok(grid.backward_from(b, SweepVectors { x: z, t, partials }, c));
        }
        Ok(grid.backward(b, SweepVectors { x: z, t, partials }, l > 0, c))
    }

    /// Solves level `l` roughly: `levels[0].z` ≈ A⁻¹ `levels[0].b`; b is used up.
    ///
    /// Two steps of flexible conjugate gradients per column, each preconditioned by a cycle (a K-cycle): their inner
    /// products keep the whole operation positive where plain recursion can fail.
    pub(crate) fn solve(&self, l: usize, levels: &mut [CoarseVectors]) -> Result<(), Cancelled> {
        let Some((here, below)) = levels.split_first_mut() else {
            return Ok(());
        };
        if below.is_empty() {
            self.solve_coarsest(here);
            return Ok(());
        }
        let grid = self.grid(l);
        let CoarseVectors {
            b,
            z,
            t,
            first_z,
            first_v,
            partials,
            ..
        } = here;
        let [zb, zv, bb] = self.run(l, b, SweepVectors { x: z, t, partials }, None, below)?;
        if self.system.cycles_per_visit[l] < 2 {
            return Ok(());
        }
        let first = per_lane(|c| ratio(zb[c], zv[c]));
        std::mem::swap(z, first_z);
        std::mem::swap(t, first_v);
        let rr = step(&grid, first, first_z, first_v, b, partials);
        if (0..WIDTH).all(|c| rr[c] <= ENOUGH * bb[c]) {
            combine_steps(&grid, z, first_z, None, first);
            return Ok(());
        }
        let [zr, ww, wv] = self.run(l, b, SweepVectors { x: z, t, partials }, Some(first_v), below)?;
        let overlap = per_lane(|c| ratio(wv[c], zv[c]));
        let second = per_lane(|c| ratio(zr[c], ww[c] - overlap[c] * wv[c]));
        let first = per_lane(|c| first[c] - second[c] * overlap[c]);
        combine_steps(&grid, z, first_z, Some(second), first);
        Ok(())
    }

    fn solve_coarsest(&self, here: &mut CoarseVectors) {
        let (rows, inverse) = (&self.system.dense_rows, &self.system.inverse);
        here.dense.clear();
        here.dense.extend(rows.iter().map(|&i| here.b[i as usize].to_wide()));
        here.z.fill(Lanes::ZERO);
        for (k, &i) in rows.iter().enumerate() {
            here.z[i as usize] = Lanes::from_wide(inverse.row_times(k, &here.dense));
        }
    }
}

/// The vectors of all levels below the finest, sized for a system.
pub(crate) fn prepare(cycle: &MultigridCycle<'_>, levels: &mut Vec<CoarseVectors>) {
    levels.resize_with(cycle.system.masks.len() - 1, CoarseVectors::default);
    for (k, coarse) in levels.iter_mut().enumerate() {
        coarse.prepare(&cycle.grid(k + 1));
    }
}

/// v becomes A z, b −= factor · v; returns (b, b). `v` comes as the sweep left it that made z.
fn step(
    grid: &MaskedLevel<'_>,
    factor: WideLanes,
    z: &[Lanes],
    v: &mut [Lanes],
    b: &mut [Lanes],
    partials: &mut Vec<LaneDots>,
) -> WideLanes {
    let factor = Lanes::from_wide(factor);
    let [rr, _, _] = grid.sum_over_blocks((b, v), partials, |rows, (b, v)| {
        let mut sum = Lanes::ZERO;
        let bundles = b
            .as_chunks_mut::<SLICE_ROWS>()
            .0
            .iter_mut()
            .zip(v.as_chunks_mut::<SLICE_ROWS>().0);
        for ((b, v), k) in bundles.zip(rows.start / SLICE_ROWS..) {
            *v = grid.matrix_products(z, v, k);
            for d in 0..SLICE_ROWS {
                b[d] -= v[d] * factor;
                sum += b[d] * b[d];
            }
        }
        [sum, Lanes::ZERO, Lanes::ZERO]
    });
    rr
}

/// z = second · z + first · first_z; without `second`, z = first · first_z.
fn combine_steps(
    grid: &MaskedLevel<'_>,
    z: &mut [Lanes],
    first_z: &[Lanes],
    second: Option<WideLanes>,
    first: WideLanes,
) {
    let first = Lanes::from_wide(first);
    let second = second.map(Lanes::from_wide);
    grid.each_block(z, |_, rows, z| {
        for (z, f) in z.iter_mut().zip(&first_z[rows]) {
            *z = match second {
                Some(second) => *z * second + *f * first,
                None => *f * first,
            };
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::group::Workspace;
    use crate::testing::{BoxLattice, pool};
    use pliant_exec::progress::Silent;

    /// M u for the cycle M, with u masked.
    fn apply(hierarchy: &Hierarchy, system: &LinearSystem, u: &[f32]) -> Vec<Lanes> {
        let threads = Parallelism::from_pool(&pool());
        let cycle = MultigridCycle {
            hierarchy,
            system,
            threads,
            progress: &Silent,
        };
        let mut workspace = Workspace::default();
        prepare(&cycle, &mut workspace.coarse);
        let mask = &system.masks[0];
        let b: Vec<Lanes> = u
            .iter()
            .enumerate()
            .map(|(i, v)| if mask.free(i) { Lanes::splat(*v) } else { Lanes::ZERO })
            .collect();
        let (mut z, mut t) = (b.clone(), b.clone());
        clear_inactive(&cycle.grid(0), &mut z);
        clear_inactive(&cycle.grid(0), &mut t);
        let mut partials = Vec::new();
        fn vectors<'v>(x: &'v mut [Lanes], t: &'v mut [Lanes], partials: &'v mut Vec<LaneDots>) -> SweepVectors<'v> {
            SweepVectors { x, t, partials }
        }
        let c = Some(b.as_slice());
        let dots = cycle
            .run(0, &b, vectors(&mut z, &mut t, &mut partials), c, &mut workspace.coarse)
            .unwrap();

        // Both ways to A z give it, and the inner products are those of z.
        let level = &hierarchy.levels[0];
        for (k, t) in t.as_chunks_mut::<SLICE_ROWS>().0.iter_mut().enumerate() {
            *t = cycle.grid(0).edge_flows(&z, k);
        }
        let mut again = z.clone();
        let mut left = vec![Lanes::ZERO; z.len()];
        cycle
            .grid(0)
            .backward(&b, vectors(&mut again, &mut left, &mut partials), true, None);
        let size = again.iter().fold(1.0, |a: f32, z| a.max(z.0[1].abs()));
        for (k, left) in left.as_chunks::<SLICE_ROWS>().0.iter().enumerate() {
            let (made, want) = (
                cycle.grid(0).matrix_products(&again, left, k),
                cycle.grid(0).edge_flows(&again, k),
            );
            for d in 0..SLICE_ROWS {
                assert!((made[d].0[1] - want[d].0[1]).abs() < 1e-4 * size, "bundle {k}");
            }
        }
        let dot = |a: &[Lanes]| {
            a.iter()
                .zip(&z)
                .map(|(a, z)| f64::from(a.0[1]) * f64::from(z.0[1]))
                .sum::<f64>()
        };
        for (seen, want) in dots.iter().zip([dot(&b), dot(&t), dot(&b)]) {
            assert!((seen[1] - want).abs() < 1e-4 * want.abs(), "{} against {want}", seen[1]);
        }
        for i in 0..level.rows() {
            let flow = |(j, w): (usize, f32)| w * (z[i].0[1] - z[j].0[1]);
            let want: f32 = level.row(i).map(flow).sum();
            let want = if mask.free(i) { want } else { 0.0 };
            assert!(
                (t[i].0[1] - want).abs() < 1e-4 * size,
                "row {i}: {} against {want}",
                t[i].0[1]
            );
        }
        z
    }

    fn vectors(n: usize) -> (Vec<f32>, Vec<f32>) {
        let u = (0..n).map(|i| ((i * 7919) % 101) as f32 / 50.0 - 1.0).collect();
        let v = (0..n).map(|i| ((i * 104_729) % 97) as f32 / 48.0 - 1.0).collect();
        (u, v)
    }

    fn dot(a: &[f32], b: &[Lanes]) -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(b.0[2])).sum()
    }

    #[test]
    fn the_cycle_is_symmetric_and_positive() {
        // A block, a shell and a strip; on the thin ones the finest level is swept forth and back.
        for (sides, levels, is_thin) in [([21, 18, 18], 4, false), ([12, 40, 1], 3, true), ([4, 75, 1], 3, true)] {
            let [nx, ny, nz] = sides;
            let block = BoxLattice::new(nx, ny, nz).weighted();
            let hierarchy = block.hierarchy(20);
            let mut system = block.system(&hierarchy);
            // Under Miri the thin ones are so small that they are solved directly.
            if cfg!(miri) && system.is_direct() {
                continue;
            }
            let (u, v) = vectors(hierarchy.levels[0].rows());
            let has_all = hierarchy.levels.len() >= levels && system.cycles_per_visit.contains(&2);
            assert!(cfg!(miri) || has_all && system.twice == is_thin, "{sides:?}");
            assert!(
                dot(&u, &apply(&hierarchy, &system, &u)) > 0.0,
                "with inner products it is positive"
            );
            system.cycles_per_visit.fill(1);
            let (mu, mv) = (apply(&hierarchy, &system, &u), apply(&hierarchy, &system, &v));
            let (uv, vu) = (dot(&u, &mv), dot(&v, &mu));
            let size = (dot(&u, &mu) * dot(&v, &mv)).sqrt();
            assert!(
                (uv - vu).abs() < 1e-5 * size,
                "{sides:?}: {uv} against {vu}, size {size}"
            );
            assert!(dot(&u, &mu) > 0.0 && dot(&v, &mv) > 0.0);
        }
    }

    #[test]
    fn masked_rows_stay_zero() {
        let block = BoxLattice::new(21, 18, 18);
        let hierarchy = block.hierarchy(20);
        let system = block.system(&hierarchy);
        let z = apply(&hierarchy, &system, &vec![1.0; hierarchy.levels[0].rows()]);
        for (i, z) in z.iter().enumerate() {
            assert_eq!(system.masks[0].free(i), *z != Lanes::ZERO, "row {i}");
        }
    }
}
