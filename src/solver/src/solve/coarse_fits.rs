//! Rotations fitted on coarse levels, where a fit and a solve cost little and move whole limbs.
//!
//! Fitting and solving in turn creeps where a part is slender: each round passes on how one end is bent by about its thickness.
//! A coarse level has the same slow modes and next to nothing to compute. So the start by full multigrid solves the *non-linear*
//! equations on the way down: on each level rotations are fitted to the solution and the solution corrected by a cycle, with
//! quasi-Newton steps, until the energy hardly falls; what rotations have changed by is handed to the level below.
//!
//! Limited-memory quasi-Newton steps (Nocedal's L-BFGS) on the rows of one level, with a multigrid cycle as the first guess of the
//! inverse: what Liu, Bouaziz and Kavan (2017) do with a factorisation.

use crate::build::level::HierarchyLevel;
use crate::lanes::{Lanes, NO_ROW, SLICE_ROWS};
use crate::solve::cycle::{CoarseVectors, MultigridCycle};
use crate::solve::patches::{AffinePatches, PatchMap, STILL, Turn, after, nearest_turns, times, turned};
use crate::solve::sweep::MaskedLevel;
use pliant_exec::progress::{Cancelled, check};

/// Bundles that one piece of work handles.
const PIECE: usize = 256;
/// Fits on one level at most.
const MOST_FITS: usize = 48;
/// An energy that rises by more than this part of it shows that steps were too long.
const RISE: f64 = 0.002;

/// By which part of it the energy must fall, and over how many fits. Large levels leave more to the levels below: their fits cost
/// nearly as much as those of the finest.
fn enough_of(rows: usize) -> (f64, usize) {
    match rows {
        0..2048 => (0.001, 3),
        2048..8192 => (0.003, 3),
        _ => (0.006, 1),
    }
}

/// Rotations that are fitted while full multigrid comes down.
pub(crate) struct CoarseFits {
    /// By level, finest first: whether the rotation of a row is fitted.
    open: Vec<Vec<bool>>,
    /// What the rows of the level under way are turned by, over the maps that came with the pose.
    turns: Vec<Turn>,
}

impl CoarseFits {
    /// `open`: whether the rotation of each row of the finest level is.
    pub(crate) fn new(cycle: &MultigridCycle<'_>, open: &[bool]) -> Self {
        let levels = &cycle.hierarchy.levels;
        let mut all = vec![open.to_vec()];
        for l in 1..cycle.system.masks.len() {
            let (fine, rows) = (&all[l - 1], levels[l].rows());
            let is_open = |row| levels[l - 1].members_of(row).iter().any(|&i| fine[i as usize]);
            all.push((0..rows).map(is_open).collect());
        }
        Self {
            open: all,
            turns: Vec::new(),
        }
    }

    /// What the rows of the first coarse level have been turned by.
    pub(crate) fn turns(&self) -> &[Turn] {
        &self.turns
    }

    /// Fits and corrects on level `l`, whose solution `patches` hold.
    pub(crate) fn fit_level(
        &mut self,
        cycle: &MultigridCycle<'_>,
        l: usize,
        patches: &mut AffinePatches,
        vectors: &mut [CoarseVectors],
        defect: impl Fn(&MaskedLevel<'_>, &AffinePatches, &mut [Lanes]),
    ) -> Result<(), Cancelled> {
        let grid = cycle.grid(l);
        let n = grid.level.rows();
        if self.turns.len() != n {
            self.turns = vec![STILL; n];
        }
        let (enough, patience) = enough_of(n);
        let mut memory = StepMemory::default();
        let mut residual = vec![Lanes::ZERO; n];
        let mut energies: Vec<f64> = Vec::with_capacity(MOST_FITS);
        while energies.len() < MOST_FITS {
            check(cycle.progress)?;
            let energy = self.fit(&grid, l, patches);
            if let Some(&last) = energies.last()
                && energy > last * (1.0 + RISE)
            {
                memory.forget();
            }
            energies.push(energy);
            defect(&grid, patches, &mut residual);
            memory.before_cycle(&patches.x, &residual, &mut vectors[0].b);
            cycle.solve(l, vectors)?;
            let step = &mut vectors[0].z;
            memory.after_cycle(step);
            patches.x.iter_mut().zip(&*step).for_each(|(x, step)| *x += *step);
            let before = energies.len().checked_sub(patience + 1).map(|k| energies[k]);
            if !energy.is_finite() || before.is_some_and(|before| before - energy < enough * energy) {
                break;
            }
        }
        Ok(())
    }

    /// Turns each row's map to fit the positions best; returns Σ w |x_i − x_j − F_i (p_i − p_j)|² over rows that are open.
    fn fit(&mut self, grid: &MaskedLevel<'_>, l: usize, patches: &mut AffinePatches) -> f64 {
        let (level, open) = (grid.level, &self.open[l]);
        let mut maps = std::mem::take(&mut patches.maps);
        let patches_now = &*patches;
        let energies = grid.threads.map_pieces(
            PIECE * SLICE_ROWS,
            (maps.as_mut_slice(), self.turns.as_mut_slice()),
            || (),
            |(), first, (maps, turns)| {
                let mut energy = 0.0;
                let bundles = maps.as_chunks_mut::<SLICE_ROWS>().0.iter_mut();
                let bundles = bundles.zip(turns.as_chunks_mut::<SLICE_ROWS>().0);
                for ((maps, turns), first) in bundles.zip((first..).step_by(SLICE_ROWS)) {
                    if !(0..SLICE_ROWS).any(|d| open[first + d]) {
                        continue;
                    }
                    let sums: [_; SLICE_ROWS] =
                        std::array::from_fn(|d| row_sums(level, patches_now, first + d, &maps[d]));
                    let fitted = nearest_turns(sums.each_ref().map(|(columns, _)| columns));
                    for (d, (turn, trace)) in fitted.into_iter().enumerate().filter(|(d, _)| open[first + d]) {
                        let [x, y, z, _] = sums[d].1.to_wide();
                        energy += x + y + z - 2.0 * trace;
                        maps[d] = turned(turn, &maps[d]);
                        turns[d] = after(turn, turns[d]);
                    }
                }
                energy
            },
        );
        patches.maps = maps;
        energies.iter().sum()
    }

    /// Hands the turns of level `l` to the rows of the level below it, whose maps are turned.
    pub(crate) fn hand_down(&mut self, grid: &MaskedLevel<'_>, below: usize, fine: &mut AffinePatches) {
        let (level, open) = (grid.level, &self.open[below]);
        let coarse = std::mem::take(&mut self.turns);
        self.turns = vec![STILL; level.rows()];
        for (i, turn) in self.turns.iter_mut().enumerate() {
            let aggregate = level.aggregates[i];
            if open[i] && aggregate != NO_ROW {
                *turn = coarse[aggregate as usize];
                fine.maps[i] = turned(*turn, &fine.maps[i]);
            }
        }
    }
}

/// Σ w (x_i − x_j) (F_i (p_i − p_j))ᵀ by columns, and Σ w (|F_i (p_i − p_j)|² + |x_i − x_j|²) by lanes, of one row.
#[inline(always)]
fn row_sums(level: &HierarchyLevel, patches: &AffinePatches, i: usize, map: &PatchMap) -> (PatchMap, Lanes) {
    let (mut sums, mut squares) = ([Lanes::ZERO; 3], Lanes::ZERO);
    let (here, place) = (patches.positions[i], patches.x[i]);
    for (j, w) in level.row(i) {
        let edge = times(map, here - patches.positions[j]);
        let flow = place - patches.x[j];
        let weighted = flow * w;
        (0..3).for_each(|c| sums[c] += weighted * edge.0[c]);
        squares += edge * edge * w + flow * weighted;
    }
    (sums, squares)
}

/// Steps that are remembered.
const DEPTH: usize = 5;

/// The last few steps and what they did to the residual.
#[derive(Debug, Default)]
pub(crate) struct StepMemory {
    pairs: Vec<StepPair>,
    last: Option<(Vec<Lanes>, Vec<Lanes>)>,
    /// What the cycle is short of, pair by pair.
    factors: Vec<f64>,
}

#[derive(Debug)]
struct StepPair {
    step: Vec<Lanes>,
    /// The residual before, less that after.
    fall: Vec<Lanes>,
    product: f64,
}

impl StepMemory {
    /// Forgets all steps.
    pub(crate) fn forget(&mut self) {
        self.pairs.clear();
        self.last = None;
    }

    /// Takes note of a residual at x, and makes of it what the cycle is to be given.
    pub(crate) fn before_cycle(&mut self, x: &[Lanes], residual: &[Lanes], right: &mut [Lanes]) {
        if let Some((last_x, last_residual)) = self.last.take() {
            let difference =
                |a: &[Lanes], b: &[Lanes]| -> Vec<Lanes> { a.iter().zip(b).map(|(a, b)| *a - *b).collect() };
            let (step, fall) = (difference(x, &last_x), difference(&last_residual, residual));
            let product = inner_product(&step, &fall);
            if product > 0.0 {
                if self.pairs.len() == DEPTH {
                    self.pairs.remove(0);
                }
                self.pairs.push(StepPair { step, fall, product });
            }
        }
        self.last = Some((x.to_vec(), residual.to_vec()));
        right.copy_from_slice(residual);
        self.factors.clear();
        self.factors.resize(self.pairs.len(), 0.0);
        for (pair, factor) in self.pairs.iter().zip(&mut self.factors).rev() {
            *factor = inner_product(&pair.step, right) / pair.product;
            add_times(right, -*factor, &pair.fall);
        }
    }

    /// Makes a step of what the cycle has made.
    pub(crate) fn after_cycle(&self, step: &mut [Lanes]) {
        for (pair, factor) in self.pairs.iter().zip(&self.factors) {
            let beta = inner_product(&pair.fall, step) / pair.product;
            add_times(step, factor - beta, &pair.step);
        }
    }
}

fn inner_product(a: &[Lanes], b: &[Lanes]) -> f64 {
    // In pieces, each in single precision but for its sum.
    const PIECE: usize = 64;
    let pieces = a.chunks(PIECE).zip(b.chunks(PIECE));
    let of_piece = |(a, b): (&[Lanes], &[Lanes])| {
        let mut sum = Lanes::ZERO;
        a.iter().zip(b).for_each(|(a, b)| sum += *a * *b);
        let [x, y, z, _] = sum.to_wide();
        x + y + z
    };
    pieces.map(of_piece).sum()
}

fn add_times(to: &mut [Lanes], factor: f64, what: &[Lanes]) {
    to.iter_mut()
        .zip(what)
        .for_each(|(to, what)| *to += *what * factor as f32);
}
