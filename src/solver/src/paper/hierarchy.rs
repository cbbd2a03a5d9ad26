//! The levels of the paper's hierarchy and the equations on them: the finest level is the caller's graph cut by
//! constraints; section 4 chooses which vertices are elevated, and which of them are joined.

use std::sync::Arc;

use crate::build::hierarchy::Hierarchy;
use crate::dense_inverse::DenseInverse;
use crate::lanes::NO_ROW;
use crate::options::{BuildOptions, LevelSize};
use crate::paper::level::{LevelEquations, PaperLevel, RETAINED, UncutGraph};
use crate::paper::restrict::{OperatorReading, restrict_equations_by};

/// Most vertices of a coarsest level that could not be coarsened any further.
const DENSE: usize = 1000;

/// The levels of one set of constraints.
#[derive(Debug)]
pub(crate) struct PaperHierarchy {
    /// The graph that they were made of.
    pub(super) uncut: Arc<UncutGraph>,
    /// Vertex of the caller's graph that each vertex of the finest level stands for, ascending.
    pub(super) vertices: Vec<u32>,
    /// Its row in the parent module's order.
    pub(super) rows: Vec<u32>,
    /// Finest first; at least one.
    pub(super) levels: Vec<PaperLevel>,
    /// `chains[s][k]`: on level s + k, the defect equations of the original equations of level s; those themselves for
    /// k = 0. Pairs of equal s + k share their graph.
    pub(super) chains: Vec<Vec<LevelEquations>>,
    /// The coarsest equations of each chain.
    pub(super) inverses: Vec<DenseInverse>,
    /// Conjugate-gradient steps after each cycle; `None`: two where a tolerance of 1e-5 or less is asked for.
    pub(super) steps: Option<usize>,
    /// False if the graph resisted coarsening: its coarse levels would have grown too dense or hardly shrunk.
    pub(super) usable: bool,
}

impl PaperHierarchy {
    /// Builds the levels over the free vertices: those that `fixed` does not hold.
    ///
    /// `stiffness` is α of soft constraints in row order of `hierarchy`, whose scaling of weights is adopted.
    pub(crate) fn build(
        uncut: &Arc<UncutGraph>,
        hierarchy: &Hierarchy,
        fixed: &[bool],
        stiffness: &[f64],
    ) -> PaperHierarchy {
        let options = &uncut.options;
        let (vertices, rows, finest, original) = uncut.free(hierarchy, fixed, stiffness);
        let (levels, usable) = levels(finest, options);
        let mut built = PaperHierarchy {
            uncut: Arc::clone(uncut),
            vertices,
            rows,
            levels,
            chains: Vec::new(),
            inverses: Vec::new(),
            steps: options.interleave,
            usable,
        };
        if usable {
            built.fill_chains(original);
        }
        built
    }

    /// Equations of every chain: originals from level to level, and from each of them its defect equations.
    fn fill_chains(&mut self, mut original: LevelEquations) {
        for s in 0..self.levels.len() {
            let next = self
                .below(s)
                .map(|c| restrict_equations_by(&self.levels[s], &original, c, OperatorReading::Pruned));
            let mut chain = vec![original];
            for k in s..self.levels.len() - 1 {
                let equations = restrict_equations_by(
                    &self.levels[k],
                    &chain[k - s],
                    &self.levels[k + 1],
                    OperatorReading::Held,
                );
                chain.push(equations);
            }
            let last = (&self.levels[self.levels.len() - 1], &chain[chain.len() - 1]);
            self.inverses.push(last.1.inverse(last.0));
            self.chains.push(chain);
            original = match next {
                Some(next) => next,
                None => break,
            };
        }
    }

    fn below(&self, level: usize) -> Option<&PaperLevel> {
        self.levels.get(level + 1)
    }

    /// Sizes of the levels, finest first.
    pub(crate) fn level_sizes(&self) -> Vec<LevelSize> {
        let facts = |l: &PaperLevel| LevelSize {
            vertices: l.vertices(),
            edges: l.neighbours.len() / 2,
        };
        self.levels.iter().filter(|l| l.vertices() > 0).map(facts).collect()
    }

    /// Bytes held.
    pub(crate) fn byte_size(&self) -> usize {
        let levels: usize = self.levels.iter().map(PaperLevel::byte_size).sum();
        let chains: usize = self.chains.iter().flatten().map(LevelEquations::byte_size).sum();
        let inverses: usize = self.inverses.iter().map(DenseInverse::byte_size).sum();
        levels + chains + inverses + 4 * (self.vertices.len() + self.rows.len())
    }
}

/// Coarsens until a level is small enough to be solved directly. False if that was given up.
fn levels(finest: PaperLevel, options: &BuildOptions) -> (Vec<PaperLevel>, bool) {
    let mut levels = vec![finest];
    loop {
        let last = levels.len() - 1;
        if levels[last].vertices() <= options.coarsest {
            return (levels, true);
        }
        match coarsen(&mut levels[last], options.coarsening) {
            Some(coarse) => levels.push(coarse),
            None => {
                let usable = levels[last].vertices() <= DENSE;
                return (levels, usable);
            }
        }
    }
}

/// Vertices with more neighbours than this are asked first whether they become seeds.
const HUB: usize = 64;
/// Coarsening has failed if the next level is not smaller than this part of the level.
const SHRINKS: f64 = 0.9;
/// Coarsening has failed if joining seeds visits this many times more pairs than the level has entries.
const DENSER: usize = 8;

/// Elevates a maximal δ-independent set of `level` and returns the graph of the elevated vertices, or `None` if that
/// would be hardly smaller or far denser. δ is the mean edge length times r^(−1/3).
pub(super) fn coarsen(level: &mut PaperLevel, r: f64) -> Option<PaperLevel> {
    let n = level.vertices();
    let most = |seeds: &[bool]| seeds.iter().filter(|s| **s).count() as f64 <= SHRINKS * n as f64;
    let mut seeds = independent_set(level, seed_distance(level, r));
    if !most(&seeds) {
        // Edge lengths of many magnitudes: distance would keep nearly everything.
        seeds = independent_set(level, f64::INFINITY);
        if !most(&seeds) {
            return None;
        }
    }
    elevate_seeds(level, &seeds);
    join_seeds(level)
}

/// δ of section 4. Without positions, infinite: all neighbours are close.
fn seed_distance(level: &PaperLevel, r: f64) -> f64 {
    if level.positions.is_empty() || level.neighbours.is_empty() {
        return f64::INFINITY;
    }
    let n = level.vertices();
    let total: f64 = (0..n)
        .map(|i| level.edges(i).map(|(_, j)| distance(level, i, j)).sum::<f64>())
        .sum();
    total / level.neighbours.len() as f64 * libm::pow(r, -1.0 / 3.0)
}

fn distance(level: &PaperLevel, i: usize, j: usize) -> f64 {
    let (a, b) = (level.positions[i], level.positions[j]);
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
}

/// A maximal set of vertices of which no two neighbours are within `delta` of each other, by one sweep: a vertex joins
/// unless it is within `delta` of a neighbour that has. Every other vertex with neighbours thus has one in the set.
/// Vertices without neighbours stay out.
fn independent_set(level: &PaperLevel, delta: f64) -> Vec<bool> {
    let n = level.vertices();
    let (mut seeds, mut taken) = (vec![false; n], vec![false; n]);
    for hubs in [true, false] {
        for i in 0..n {
            let degree = level.row(i).len();
            if (degree > HUB) != hubs || taken[i] || degree == 0 {
                continue;
            }
            seeds[i] = true;
            for (_, j) in level.edges(i) {
                // Also where a distance is not a number.
                let apart = delta.is_finite() && distance(level, i, j) > delta;
                taken[j] |= !apart;
            }
        }
    }
    seeds
}

fn elevate_seeds(level: &mut PaperLevel, seeds: &[bool]) {
    level.seeds = (0..seeds.len()).filter(|&i| seeds[i]).map(|i| i as u32).collect();
    level.elevated = vec![RETAINED; seeds.len()];
    for (c, &i) in level.seeds.iter().enumerate() {
        level.elevated[i as usize] = c as u32;
    }
}

/// The graph of the elevated vertices: joined if they were neighbours, or if both neighbour one retained vertex.
fn join_seeds(level: &PaperLevel) -> Option<PaperLevel> {
    let retained = (0..level.vertices()).filter(|&i| level.elevated[i] == RETAINED);
    let pairs = retained
        .map(|i| level.to_elevated(i).count())
        .fold(0usize, |sum, k| sum.saturating_add(k.saturating_mul(k)));
    if pairs > DENSER.saturating_mul(level.neighbours.len()) {
        return None;
    }
    let mut coarse = PaperLevel {
        offsets: vec![0],
        positions: match level.positions.is_empty() {
            true => Vec::new(),
            false => level.seeds.iter().map(|&j| level.positions[j as usize]).collect(),
        },
        ..PaperLevel::default()
    };
    let mut last_row = vec![u32::MAX; level.seeds.len()];
    for (c, &j) in level.seeds.iter().enumerate() {
        let begin = coarse.neighbours.len();
        last_row[c] = c as u32;
        let mut join = |k: usize| {
            if std::mem::replace(&mut last_row[k], c as u32) != c as u32 {
                coarse.neighbours.push(k as u32);
            }
        };
        level.to_elevated(j as usize).for_each(|(_, k)| join(k));
        for (_, i) in level.to_retained(j as usize) {
            level.to_elevated(i).for_each(|(_, k)| join(k));
        }
        coarse.neighbours[begin..].sort_unstable();
        coarse.offsets.push(coarse.neighbours.len());
    }
    Some(coarse)
}

impl UncutGraph {
    /// Equation (11): the graph of the free vertices. Fixed neighbours are counted in α, and so is stiffness.
    ///
    /// Returns the vertex and the row in `hierarchy` of each free vertex, their graph, and its equations with weights
    /// scaled as in `hierarchy`.
    pub(super) fn free(
        &self,
        hierarchy: &Hierarchy,
        fixed: &[bool],
        stiffness: &[f64],
    ) -> (Vec<u32>, Vec<u32>, PaperLevel, LevelEquations) {
        let mut row_of = vec![NO_ROW; fixed.len()];
        for (row, &vertex) in hierarchy.order.iter().enumerate().filter(|(_, v)| **v != NO_ROW) {
            row_of[vertex as usize] = row as u32;
        }
        let vertices: Vec<u32> = (0..fixed.len()).filter(|&v| !fixed[v]).map(|v| v as u32).collect();
        let rows: Vec<u32> = vertices.iter().map(|&v| row_of[v as usize]).collect();
        let mut number = vec![NO_ROW; fixed.len()];
        for (i, &v) in vertices.iter().enumerate() {
            number[v as usize] = i as u32;
        }
        let mut level = PaperLevel {
            offsets: vec![0],
            positions: match self.positions.is_empty() {
                true => Vec::new(),
                false => vertices.iter().map(|&v| self.positions[v as usize]).collect(),
            },
            ..PaperLevel::default()
        };
        let (mut weights, mut alphas) = (Vec::new(), Vec::with_capacity(vertices.len()));
        for (&v, &row) in vertices.iter().zip(&rows) {
            let mut alpha = stiffness.get(row as usize).copied().unwrap_or(0.0);
            for e in self.offsets[v as usize] as usize..self.offsets[v as usize + 1] as usize {
                let j = number[self.neighbours[e] as usize];
                let w = self.weights.as_ref().map_or(1.0, |w| f64::from(w[e])) * hierarchy.weight_scale;
                if j == NO_ROW {
                    alpha += w;
                } else {
                    level.neighbours.push(j);
                    weights.push(w);
                }
            }
            level.offsets.push(level.neighbours.len());
            alphas.push(alpha);
        }
        let equations = LevelEquations::new(&level, weights, alphas);
        (vertices, rows, level, equations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper::level::tests::level_of;
    use crate::paper::testing::lattice;

    #[test]
    fn seeds_are_independent_and_reach_everyone() {
        let block = lattice(9);
        for r in [0.1, 0.2, 1.0] {
            let mut level = level_of(&block.view());
            let delta = seed_distance(&level, r);
            let coarse = coarsen(&mut level, r).unwrap();
            assert_eq!(coarse.vertices(), level.seeds.len());
            for i in 0..level.vertices() {
                if level.elevated[i] == RETAINED {
                    let near = level
                        .edges(i)
                        .any(|(_, j)| level.elevated[j] != RETAINED && distance(&level, i, j) <= delta);
                    assert!(near, "vertex {i} could have been a seed");
                } else {
                    for (_, j) in level.edges(i) {
                        assert!(level.elevated[j] == RETAINED || distance(&level, i, j) > delta);
                    }
                }
            }
        }
    }

    #[test]
    fn elevated_vertices_are_joined_over_retained_ones() {
        let block = lattice(6);
        let mut level = level_of(&block.view());
        let coarse = coarsen(&mut level, 0.2).unwrap();
        for c in 0..coarse.vertices() {
            for k in 0..coarse.vertices() {
                let (i, j) = (level.seeds[c] as usize, level.seeds[k] as usize);
                let direct = level.edges(i).any(|(_, m)| m == j);
                let over = level
                    .to_retained(i)
                    .any(|(_, m)| level.edges(m).any(|(_, end)| end == j));
                let row = &coarse.neighbours[coarse.row(c)];
                assert!(row.windows(2).all(|w| w[0] < w[1]));
                assert_eq!(row.binary_search(&(k as u32)).is_ok(), c != k && (direct || over));
            }
        }
    }

    /// A star: rows of `leaves` leaves around a centre that comes last.
    fn star(leaves: u32) -> PaperLevel {
        let mut level = PaperLevel {
            offsets: (0..=leaves as usize).collect(),
            neighbours: vec![leaves; leaves as usize],
            ..PaperLevel::default()
        };
        level.neighbours.extend(0..leaves);
        level.offsets.push(level.neighbours.len());
        level
    }

    #[test]
    fn a_hub_is_elevated_before_its_leaves() {
        let mut level = star(500);
        let coarse = coarsen(&mut level, 0.2).unwrap();
        assert_eq!((coarse.vertices(), coarse.neighbours.len()), (1, 0));
        assert_eq!(level.seeds, [500]);
    }

    #[test]
    fn a_level_that_would_become_dense_is_refused() {
        // A hub that is retained, with all its leaves elevated: they would all be joined to each other.
        let mut level = star(3000);
        let mut seeds = vec![true; 3001];
        seeds[3000] = false;
        elevate_seeds(&mut level, &seeds);
        assert!(join_seeds(&level).is_none());
    }
}
