//! The caller's graph, kept so that constraints can cut it, and the finest level that is left.

use crate::build::hierarchy::Hierarchy;
use crate::paper::equations::LevelEquations;
use crate::paper::kept::UncutGraph;
use crate::paper::level::PaperLevel;
use crate::storage::NO_ROW;

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
