//! The caller's graph, kept so that constraints can cut it.

use crate::graph::WeightedGraph;
use crate::options::BuildOptions;

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
