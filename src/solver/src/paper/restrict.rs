//! Prolongation and restriction: equations (14), (15), (17) and the appendix, (18) to (22).
//!
//! Both prolongations have one form, x_i = (Σ_{j∈R(i)} w_ij (x_j + d_ji) + β_i) / Z_i, without d and with ζ for β in
//! the defect equations. They differ in the pivot Z alone. So does all that follows from substituting them.
//!
//! The smoothing operator (7), residuals, and the conjugate-gradient steps of section 6.
//!
//! One graph G^l of the hierarchy: which vertices are joined, and which are elevated to the next level; the weights and α of
//! equations of the form (12) on it; and the caller's graph, stored so that constraints can cut it.

use crate::dense_inverse::DenseInverse;
use crate::graph::WeightedGraph;
use crate::lanes::{WIDTH, WideLanes, per_lane, ratio};
use crate::options::BuildOptions;
use pliant_exec::progress::{Cancelled, Progress, check};

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

/// Sets x_i to what its equation says, given the present neighbours (7).
#[inline]
fn relax(level: &PaperLevel, equations: &LevelEquations, b: &[WideLanes], x: &mut [WideLanes], i: usize) {
    let diagonal = equations.diagonal[i];
    if diagonal > 0.0 {
        let mut sum = b[i];
        for (e, j) in level.edges(i) {
            add(&mut sum, equations.weights[e], x[j]);
        }
        x[i] = sum.map(|v| v / diagonal);
    }
}

/// One Gauss–Seidel sweep in storage order.
pub(super) fn sweep(level: &PaperLevel, equations: &LevelEquations, b: &[WideLanes], x: &mut [WideLanes]) {
    for i in 0..level.vertices() {
        relax(level, equations, b, x, i);
    }
}

/// One Gauss–Seidel sweep against storage order. The paper sweeps one way only; the other way makes the conjugate
/// gradients' preconditioner symmetric.
fn sweep_back(level: &PaperLevel, equations: &LevelEquations, b: &[WideLanes], x: &mut [WideLanes]) {
    for i in (0..level.vertices()).rev() {
        relax(level, equations, b, x, i);
    }
}

/// The defect ζ of (16) in terms of b = β + Σ w d: b_i − Σ_j w_ij (x_i − x_j) − α_i x_i.
pub(super) fn defect(
    level: &PaperLevel,
    equations: &LevelEquations,
    b: &[WideLanes],
    x: &[WideLanes],
    out: &mut [WideLanes],
) {
    for i in 0..level.vertices() {
        let mut r = b[i];
        add(&mut r, -equations.alphas[i], x[i]);
        for (e, j) in level.edges(i) {
            for c in 0..WIDTH {
                r[c] -= equations.weights[e] * (x[i][c] - x[j][c]);
            }
        }
        out[i] = r;
    }
}

/// Conjugate-gradient steps, with their vectors.
#[derive(Debug, Default)]
pub(super) struct ConjugateSteps {
    /// How many steps one run takes.
    steps: usize,
    r: Vec<WideLanes>,
    z: Vec<WideLanes>,
    p: Vec<WideLanes>,
    q: Vec<WideLanes>,
}

impl ConjugateSteps {
    pub(super) fn new(steps: usize) -> Self {
        Self {
            steps,
            ..Self::default()
        }
    }

    /// Improves `x` by all steps of conjugate gradients, all columns with their own step lengths.
    pub(super) fn run(
        &mut self,
        level: &PaperLevel,
        equations: &LevelEquations,
        b: &[WideLanes],
        x: &mut [WideLanes],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        if self.steps == 0 {
            return Ok(());
        }
        let n = level.vertices();
        let ConjugateSteps { steps, r, z, p, q } = self;
        for v in [&mut *r, &mut *z, &mut *p, &mut *q] {
            v.clear();
            v.resize(n, [0.0; WIDTH]);
        }
        let still = vec![[0.0; WIDTH]; n];
        defect(level, equations, b, x, r);
        let mut last = [0.0; WIDTH];
        for _ in 0..*steps {
            check(progress)?;
            z.fill([0.0; WIDTH]);
            sweep(level, equations, r, z);
            sweep_back(level, equations, r, z);
            let product = dot(r, z);
            let beta = per_lane(|c| ratio(product[c], last[c]));
            last = product;
            for (p, z) in p.iter_mut().zip(&*z) {
                for c in 0..WIDTH {
                    p[c] = z[c] + beta[c] * p[c];
                }
            }
            // b − A p for b = 0.
            defect(level, equations, &still, p, q);
            let energy = dot(p, q);
            let length = per_lane(|c| ratio(product[c], -energy[c]));
            for i in 0..n {
                for c in 0..WIDTH {
                    x[i][c] += length[c] * p[i][c];
                    r[i][c] += length[c] * q[i][c];
                }
            }
        }
        Ok(())
    }
}

fn dot(a: &[WideLanes], b: &[WideLanes]) -> WideLanes {
    let mut sum = [0.0; WIDTH];
    for (a, b) in a.iter().zip(b) {
        for c in 0..WIDTH {
            sum[c] += a[c] * b[c];
        }
    }
    sum
}

/// In [`PaperLevel::elevated`]: the vertex is retained.
pub(super) const RETAINED: u32 = u32::MAX;

/// A graph without numbers on its edges, and its split into elevated and retained vertices.
#[derive(Debug, Default)]
pub(super) struct PaperLevel {
    /// Where each row of `neighbours` begins, and the end.
    pub(super) offsets: Vec<usize>,
    /// Neighbours of all rows, ascending within a row.
    pub(super) neighbours: Vec<u32>,
    /// Rest positions, which only the distance threshold δ looks at; empty where none are known.
    pub(super) positions: Vec<[f64; 3]>,
    /// Number of each vertex on the next level, or [`RETAINED`]. Empty on the coarsest level.
    pub(super) elevated: Vec<u32>,
    /// The vertex here of each vertex of the next level, ascending: the inverse of `elevated`.
    pub(super) seeds: Vec<u32>,
}

impl PaperLevel {
    pub(super) fn vertices(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Entries of row `i`, as places in `neighbours`.
    #[inline]
    pub(super) fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.offsets[i]..self.offsets[i + 1]
    }

    /// Entries of row `i` with the neighbour that each names.
    #[inline]
    pub(super) fn edges(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.row(i).map(|e| (e, self.neighbours[e] as usize))
    }

    /// Edges of `i` to elevated neighbours: the entry, and the neighbour's number on the next level. R(i) of the paper.
    #[inline]
    pub(super) fn to_elevated(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.edges(i)
            .map(|(e, j)| (e, self.elevated[j]))
            .filter(|(_, c)| *c != RETAINED)
            .map(|(e, c)| (e, c as usize))
    }

    /// Edges of `i` to retained neighbours: the entry and the neighbour. K(i) of the paper.
    #[inline]
    pub(super) fn to_retained(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.edges(i).filter(|(_, j)| self.elevated[*j] == RETAINED)
    }

    pub(super) fn byte_size(&self) -> usize {
        8 * self.offsets.len()
            + 24 * self.positions.len()
            + 4 * (self.neighbours.len() + self.elevated.len() + self.seeds.len())
    }
}

/// Σ_j w_ij (x_i − x_j) + α_i x_i = b_i for all vertices of a level, without the right-hand sides.
///
/// The form (12) has d on the edges and β: b_i = β_i + Σ_j w_ij d_ji. The matrix is symmetric, and since w and α are
/// never negative it has no negative eigenvalue.
#[derive(Debug, Default)]
pub(super) struct LevelEquations {
    /// One per entry of [`PaperLevel::neighbours`], equal in both directions to the last bit.
    pub(super) weights: Vec<f64>,
    /// One per vertex.
    pub(super) alphas: Vec<f64>,
    /// Σ w + α.
    pub(super) diagonal: Vec<f64>,
}

impl LevelEquations {
    pub(super) fn new(level: &PaperLevel, weights: Vec<f64>, alphas: Vec<f64>) -> LevelEquations {
        let diagonal = (0..level.vertices())
            .map(|i| weights[level.row(i)].iter().sum::<f64>() + alphas[i])
            .collect();
        LevelEquations {
            weights,
            alphas,
            diagonal,
        }
    }

    /// Solves a small level exactly (section 5.1).
    pub(super) fn inverse(&self, level: &PaperLevel) -> DenseInverse {
        let n = level.vertices();
        let mut matrix = vec![0.0; n * n];
        for i in 0..n {
            for (e, j) in level.edges(i) {
                matrix[i * n + j] = -self.weights[e];
            }
            // A vertex that nothing holds and nothing pulls: any value will do.
            matrix[i * n + i] = if self.diagonal[i] > 0.0 { self.diagonal[i] } else { 1.0 };
        }
        DenseInverse::new(matrix, n)
    }

    pub(super) fn byte_size(&self) -> usize {
        8 * (self.weights.len() + self.alphas.len() + self.diagonal.len())
    }
}

/// A copy of the caller's graph. The paper builds its hierarchy after the constraints are known.
#[derive(Debug, Clone)]
pub(crate) struct UncutGraph {
    pub(super) offsets: Vec<u32>,
    pub(super) neighbours: Vec<u32>,
    pub(super) weights: Option<Vec<f32>>,
    pub(super) positions: Vec<[f64; 3]>,
    pub(super) options: BuildOptions,
}

impl UncutGraph {
    pub(crate) fn new(graph: &WeightedGraph<'_>, options: &BuildOptions) -> UncutGraph {
        UncutGraph {
            offsets: graph.offsets.to_vec(),
            neighbours: graph.neighbours.to_vec(),
            weights: graph.weights.map(<[f32]>::to_vec),
            positions: graph.positions.map(<[_]>::to_vec).unwrap_or_default(),
            options: options.clone(),
        }
    }

    pub(crate) fn byte_size(&self) -> usize {
        let weights = self.weights.as_ref().map_or(0, Vec::len);
        4 * (self.offsets.len() + self.neighbours.len() + weights) + 24 * self.positions.len()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::graph::WeightedGraph;
    use crate::paper::testing::{built, lattice};

    /// The graph of all vertices.
    pub(crate) fn level_of(graph: &WeightedGraph<'_>) -> PaperLevel {
        PaperLevel {
            offsets: graph.offsets.iter().map(|&o| o as usize).collect(),
            neighbours: graph.neighbours.to_vec(),
            positions: graph.positions.map(<[_]>::to_vec).unwrap_or_default(),
            ..PaperLevel::default()
        }
    }

    #[test]
    fn fixed_neighbours_and_stiffness_become_alpha() {
        let block = lattice(5).weighted();
        let fixed: Vec<bool> = block.positions.iter().map(|p| p[0] == 0.0).collect();
        let stiffness: Vec<f64> = block.positions.iter().map(|p| p[1]).collect();
        let (hierarchy, system) = built(&block, &fixed, Some(&stiffness), 30);
        let paper = system.paper.as_ref().unwrap();
        let scale = hierarchy.weight_scale;
        let finest = &paper.chains[0][0];
        let weights = block.weights.as_ref().unwrap();
        for (i, &v) in paper.vertices.iter().enumerate() {
            let row = block.offsets[v as usize] as usize..block.offsets[v as usize + 1] as usize;
            let (mut alpha, mut sum) = (stiffness[v as usize], stiffness[v as usize]);
            for e in row {
                sum += f64::from(weights[e]);
                if fixed[block.neighbours[e] as usize] {
                    alpha += f64::from(weights[e]);
                }
            }
            assert!((finest.alphas[i] - alpha * scale).abs() < 1e-12);
            assert!((finest.diagonal[i] - sum * scale).abs() < 1e-12);
            assert_eq!(hierarchy.order[paper.rows[i] as usize], v);
        }
    }
}
