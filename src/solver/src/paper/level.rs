//! One graph G^l of the hierarchy: which vertices are joined, and which are elevated to the next level; the weights and α of
//! equations of the form (12) on it; and the caller's graph, stored so that constraints can cut it.

use crate::dense_inverse::DenseInverse;
use crate::graph::WeightedGraph;
use crate::options::BuildOptions;

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
