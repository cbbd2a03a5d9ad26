//! Prolongation and restriction: equations (14), (15), (17) and the appendix, (18) to (22).
//!
//! Both prolongations have one form, x_i = (Σ_{j∈R(i)} w_ij (x_j + d_ji) + β_i) / Z_i, without d and with ζ for β in
//! the defect equations. They differ in the pivot Z alone. So does all that follows from substituting them.

use crate::lanes::{WIDTH, WideLanes};
use crate::paper::level::{LevelEquations, PaperLevel, RETAINED};

/// What is done about a retained vertex's retained neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum OperatorReading {
    /// Their edges are removed: equation (14), for original equations.
    Pruned,
    /// Their unknowns are set to 0: equation (17), for defect equations.
    Held,
}

impl OperatorReading {
    /// Z of retained vertex `i`, and the part of it that no elevated neighbour accounts for.
    fn pivot(self, level: &PaperLevel, equations: &LevelEquations, i: usize) -> (f64, f64) {
        let weight = |e: usize| equations.weights[e];
        let alpha = equations.alphas[i];
        let lost = match self {
            OperatorReading::Pruned => alpha,
            OperatorReading::Held => alpha + level.to_retained(i).map(|(e, _)| weight(e)).sum::<f64>(),
        };
        (level.to_elevated(i).map(|(e, _)| weight(e)).sum::<f64>() + lost, lost)
    }
}

/// a / z, or 0 where z is 0: a vertex that nothing holds and nothing pulls.
#[inline]
fn ratio_or_zero(a: f64, z: f64) -> f64 {
    if z > 0.0 { a / z } else { 0.0 }
}

/// The equations of the elevated vertices: the weights (19) and α (21), with the pivot of `reading`.
pub(super) fn restrict_equations_by(
    level: &PaperLevel,
    fine: &LevelEquations,
    coarse: &PaperLevel,
    reading: OperatorReading,
) -> LevelEquations {
    let pivots = pivots(level, fine, reading);
    let mut weights = vec![0.0; coarse.neighbours.len()];
    let mut alphas = Vec::with_capacity(coarse.vertices());
    let mut place = vec![0; coarse.vertices()];
    for (c, &j) in level.seeds.iter().enumerate() {
        let j = j as usize;
        coarse.edges(c).for_each(|(e, k)| place[k] = e);
        for (e, k) in level.to_elevated(j) {
            weights[place[k]] += fine.weights[e];
        }
        let mut alpha = fine.alphas[j];
        for (e, i) in level.to_retained(j) {
            let (z, lost) = pivots[i];
            alpha += ratio_or_zero(fine.weights[e] * lost, z);
            for (to, k) in level.to_elevated(i).filter(|(_, k)| *k != c) {
                // The same product in both directions, so that the sums are equal too.
                weights[place[k]] += ratio_or_zero(fine.weights[to] * fine.weights[e], z);
            }
        }
        alphas.push(alpha);
    }
    LevelEquations::new(coarse, weights, alphas)
}

/// [`OperatorReading::pivot`] of every retained vertex.
fn pivots(level: &PaperLevel, equations: &LevelEquations, reading: OperatorReading) -> Vec<(f64, f64)> {
    let pivot = |i: usize| match level.elevated[i] {
        RETAINED => reading.pivot(level, equations, i),
        _ => (0.0, 0.0),
    };
    (0..level.vertices()).map(pivot).collect()
}

/// d on the edges of a level: where one end of an edge should lie, seen from the other.
pub(super) trait EdgeOffsets {
    /// d_ji, the wanted x_i − x_j, for entry `e` of row `i`, which names `j`.
    fn d(&self, e: usize, i: usize, j: usize) -> WideLanes;
}

/// β and d of the elevated vertices, (22) and (20).
pub(super) fn restricted_constants(
    level: &PaperLevel,
    fine: &LevelEquations,
    beta: &[WideLanes],
    offsets: &dyn EdgeOffsets,
    coarse: &PaperLevel,
    restricted: &LevelEquations,
) -> (Vec<WideLanes>, Vec<WideLanes>) {
    let pivots = pivots(level, fine, OperatorReading::Pruned);
    let mut betas = Vec::with_capacity(coarse.vertices());
    let mut ds = vec![[0.0; WIDTH]; coarse.neighbours.len()];
    let mut place = vec![0; coarse.vertices()];
    for (c, &j) in level.seeds.iter().enumerate() {
        let j = j as usize;
        coarse.edges(c).for_each(|(e, k)| place[k] = e);
        for (e, k) in level.to_elevated(j) {
            add(
                &mut ds[place[k]],
                fine.weights[e],
                offsets.d(e, j, level.neighbours[e] as usize),
            );
        }
        let mut b = beta[j];
        for (e, i) in level.to_retained(j) {
            let (z, alpha) = pivots[i];
            let share = ratio_or_zero(fine.weights[e], z);
            let first = offsets.d(e, j, i);
            add(&mut b, share, beta[i]);
            add(&mut b, share * alpha, first);
            for (to, k) in level.to_elevated(i).filter(|(_, k)| *k != c) {
                let second = offsets.d(to, i, level.neighbours[to] as usize);
                let path = std::array::from_fn(|lane| first[lane] + second[lane]);
                add(
                    &mut ds[place[k]],
                    ratio_or_zero(fine.weights[to] * fine.weights[e], z),
                    path,
                );
            }
        }
        betas.push(b);
        for e in coarse.row(c) {
            ds[e] = ds[e].map(|v| ratio_or_zero(v, restricted.weights[e]));
        }
    }
    (betas, ds)
}

/// Prolongation (14) of a solution of the original equations.
pub(super) fn prolong(
    level: &PaperLevel,
    fine: &LevelEquations,
    beta: &[WideLanes],
    offsets: &dyn EdgeOffsets,
    coarse: &[WideLanes],
    x: &mut [WideLanes],
) {
    for i in 0..level.vertices() {
        x[i] = match level.elevated[i] {
            RETAINED => {
                let (z, _) = OperatorReading::Pruned.pivot(level, fine, i);
                let mut sum = beta[i];
                for (e, k) in level.to_elevated(i) {
                    add(&mut sum, fine.weights[e], coarse[k]);
                    add(&mut sum, fine.weights[e], offsets.d(e, i, level.neighbours[e] as usize));
                }
                sum.map(|v| ratio_or_zero(v, z))
            }
            k => coarse[k as usize],
        };
    }
}

/// Restriction of a defect ζ: with (17) substituted, each retained neighbour i hands on w ζ_i / Z_i.
///
/// `reading` is [`OperatorReading::Held`] in the cycle; the other one is what tests compare with.
pub(super) fn restrict_defect(
    level: &PaperLevel,
    fine: &LevelEquations,
    reading: OperatorReading,
    defect: &[WideLanes],
    coarse: &mut [WideLanes],
) {
    for (out, &j) in coarse.iter_mut().zip(&level.seeds) {
        *out = defect[j as usize];
        for (e, i) in level.to_retained(j as usize) {
            let z = defect_pivot(level, fine, reading, i);
            add(out, ratio_or_zero(fine.weights[e], z), defect[i]);
        }
    }
}

/// Adds the prolongation (17) of a coarse correction to `x`.
pub(super) fn add_correction_from(
    level: &PaperLevel,
    fine: &LevelEquations,
    reading: OperatorReading,
    coarse: &[WideLanes],
    defect: &[WideLanes],
    x: &mut [WideLanes],
) {
    for i in 0..level.vertices() {
        let correction = match level.elevated[i] {
            RETAINED => {
                let z = defect_pivot(level, fine, reading, i);
                let mut sum = defect[i];
                level
                    .to_elevated(i)
                    .for_each(|(e, k)| add(&mut sum, fine.weights[e], coarse[k]));
                sum.map(|v| ratio_or_zero(v, z))
            }
            k => coarse[k as usize],
        };
        add(&mut x[i], 1.0, correction);
    }
}

/// Z of a retained vertex. For (17) it is the diagonal.
#[inline]
fn defect_pivot(level: &PaperLevel, fine: &LevelEquations, reading: OperatorReading, i: usize) -> f64 {
    match reading {
        OperatorReading::Held => fine.diagonal[i],
        OperatorReading::Pruned => reading.pivot(level, fine, i).0,
    }
}

/// a += f b
#[inline]
pub(super) fn add(a: &mut WideLanes, f: f64, b: WideLanes) {
    for c in 0..WIDTH {
        a[c] += f * b[c];
    }
}
