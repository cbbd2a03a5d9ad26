//! The few handles that have a say at each node.

use crate::deform::fields::harmonic::HarmonicFields;
use crate::pool::Pool;
use rayon::prelude::*;

/// A share below this is left out.
const LEAST: f32 = 1e-3;

/// By node the handles that have a say there, the one with the most first, with their shares, which sum to 1.
#[derive(Debug, Clone, Default)]
pub(in crate::deform) struct SparseShares {
    /// Where each node's begin; one more at the end.
    first: Vec<u32>,
    shares: Vec<(u32, f32)>,
}

impl SparseShares {
    /// Those of fields.
    pub fn of(fields: &HarmonicFields, nodes: usize, pool: &Pool) -> Self {
        let active: Vec<usize> = (0..fields.fields.len()).filter(|&k| !fields.of(k).is_empty()).collect();
        let of_node = |node: usize| {
            let all = active.iter().map(|&k| (k as u32, fields.of(k)[node]));
            let mut some: Vec<(u32, f32)> = all.filter(|s| s.1 >= LEAST).collect();
            some.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            let sum: f32 = some.iter().map(|s| s.1).sum();
            some.iter_mut().for_each(|s| s.1 /= sum);
            some
        };
        let by_node: Vec<Vec<(u32, f32)>> =
            pool.install(|| (0..nodes).into_par_iter().with_min_len(1024).map(of_node).collect());
        let mut first = Vec::with_capacity(nodes + 1);
        first.push(0);
        let mut total = 0;
        for some in &by_node {
            total += some.len() as u32;
            first.push(total);
        }
        Self {
            first,
            shares: by_node.into_iter().flatten().collect(),
        }
    }

    /// How many nodes there are.
    pub fn nodes(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    /// The shares at a node.
    pub fn at(&self, node: usize) -> &[(u32, f32)] {
        &self.shares[self.first[node] as usize..self.first[node + 1] as usize]
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.first.capacity() * 4 + self.shares.capacity() * 8
    }
}
