//! Numbers on a level's graph: the weights and α of equations of the form (12).

use crate::dense::Inverse;
use crate::paper::level::PaperLevel;

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
    pub(super) fn inverse(&self, level: &PaperLevel) -> Inverse {
        let n = level.vertices();
        let mut matrix = vec![0.0; n * n];
        for i in 0..n {
            for (e, j) in level.edges(i) {
                matrix[i * n + j] = -self.weights[e];
            }
            // A vertex that nothing holds and nothing pulls: any value will do.
            matrix[i * n + i] = if self.diagonal[i] > 0.0 { self.diagonal[i] } else { 1.0 };
        }
        Inverse::new(matrix, n)
    }

    pub(super) fn byte_size(&self) -> usize {
        8 * (self.weights.len() + self.alphas.len() + self.diagonal.len())
    }
}
