//! Local relaxation: a solution of the equations before a change, mended around what changed.
//!
//! After a small change of the graph the old values satisfy all equations but those near it. Successive over-relaxation of
//! that neighbourhood alone brings the residual down to where the old solution left it, at the price of the change; the
//! residual that is left tells whether a solve over all vertices is needed. The order of the sweeps is fixed and one
//! thread runs them, so the bits depend on the arguments alone.

use crate::graph::WeightedGraph;
use crate::storage::NO_ROW;

/// So many rings of nodes around those that changed are relaxed together with them: the equations of the ring after them
/// keep what is left, which falls with every ring.
const RINGS: usize = 8;
/// At most so many rounds of successive over-relaxation,
const ROUNDS: usize = 64;
/// whose factor rises from 1 to what is best where point-Jacobi rounds take away this part of the error's square: a region some
/// thirty nodes across. It begins low because the first rounds would make the error of new nodes larger.
const RADIUS: f64 = 0.988;
/// Every so many rounds somebody asks whether that is enough:
const CHECK_INTERVAL: usize = 8;
/// the region's part of the residual is below this share of the right-hand side.
const SUFFICIENT: f64 = 6e-6;

/// Homogeneous equations Σ w (x_i − x_j) = 0 on a graph, a few of whose vertices changed since `x` solved them.
///
/// ```
/// use pliant_solver::{LocalRelaxation, WeightedGraph};
///
/// // A chain of five vertices between 0 and 4; the value in the middle is not known.
/// let chain = WeightedGraph {
///     offsets: &[0, 1, 3, 5, 7, 8],
///     neighbours: &[1, 0, 2, 1, 3, 2, 4, 3],
///     weights: None,
///     positions: None,
/// };
/// let relaxation = LocalRelaxation {
///     graph: chain,
///     fixed: &[true, false, false, false, true],
///     has_value: &|vertex| vertex != 2,
///     references: &[4.0],
/// };
/// let mut x = [0.0, 1.0, 0.0, 3.0, 4.0];
/// let left = relaxation.relax_around(vec![2], &mut x);
/// assert!((x[2] - 2.0).abs() < 1e-4 && left[0] < 1e-4);
/// ```
pub struct LocalRelaxation<'a> {
    /// The graph after the change.
    pub graph: WeightedGraph<'a>,
    /// By vertex: whether its value is given.
    pub fixed: &'a [bool],
    /// Tells for a vertex whether `x` holds a value for it; the others begin at the mean of their neighbours.
    pub has_value: &'a dyn Fn(usize) -> bool,
    /// By column: the norm of the right-hand side with given values moved into it, which residuals are compared with.
    pub references: &'a [f64],
}

impl LocalRelaxation<'_> {
    /// Relaxes the free vertices `changed`, which rise, and eight rings of vertices around them in `x`, row-major with one
    /// column for each of `references`. Returns the norm of each column's residual over these and the ring after them.
    pub fn relax_around(&self, changed: Vec<u32>, x: &mut [f64]) -> Vec<f64> {
        LocalEquations::around(self, changed, x).relax(x)
    }
}

impl std::fmt::Debug for LocalRelaxation<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LocalRelaxation({} vertices)", self.fixed.len())
    }
}

/// The equations of nodes that changed and of those around them, beside each other in memory.
struct LocalEquations<'a> {
    references: &'a [f64],
    /// Nodes that are relaxed, then those around them, whose residual changes too, then those around these.
    nodes: Vec<u32>,
    relaxed: usize,
    judged: usize,
    /// Edges of relaxed and judged nodes, as numbers in `nodes`.
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
    weights: Vec<f64>,
    /// By relaxed or judged node: the weights of its edges.
    diagonal: Vec<f64>,
    /// By node: its values.
    values: Vec<f64>,
    /// By node: whether it has values already.
    known: Vec<bool>,
}

impl<'a> LocalEquations<'a> {
    fn around(relaxation: &LocalRelaxation<'a>, seeds: Vec<u32>, x: &[f64]) -> Self {
        let LocalRelaxation { ref graph, fixed, .. } = *relaxation;
        let width = relaxation.references.len();
        // Numbers in `nodes`.
        let mut numbers = vec![NO_ROW; fixed.len()];
        let mut nodes = seeds;
        number_nodes(&mut numbers, &nodes);
        let mut begin = 0;
        for _ in 0..RINGS {
            begin = add_neighbours(graph, &mut nodes, &mut numbers, begin, |n| !fixed[n]);
        }
        let relaxed = nodes.len();
        // Sweeps go through memory as the graph does.
        nodes.sort_unstable();
        number_nodes(&mut numbers, &nodes);
        add_neighbours(graph, &mut nodes, &mut numbers, 0, |n| !fixed[n]);
        let judged = nodes.len();
        add_neighbours(graph, &mut nodes, &mut numbers, 0, |_| true);

        let mut equations = Self {
            references: relaxation.references,
            relaxed,
            judged,
            offsets: vec![0],
            neighbours: Vec::new(),
            weights: Vec::new(),
            diagonal: Vec::with_capacity(judged),
            values: nodes
                .iter()
                .flat_map(|&n| &x[n as usize * width..(n as usize + 1) * width])
                .copied()
                .collect(),
            known: nodes.iter().map(|&n| (relaxation.has_value)(n as usize)).collect(),
            nodes,
        };
        for &n in &equations.nodes[..judged] {
            let i = n as usize;
            let mut sum = 0.0;
            for (j, w) in edges_of(graph, i) {
                equations.neighbours.push(numbers[j]);
                equations.weights.push(w);
                sum += w;
            }
            equations.offsets.push(equations.neighbours.len() as u32);
            equations.diagonal.push(sum);
        }
        equations
    }

    fn edges(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let entries = self.offsets[i] as usize..self.offsets[i + 1] as usize;
        let neighbours = self.neighbours[entries.clone()].iter().map(|&j| j as usize);
        neighbours.zip(self.weights[entries].iter().copied())
    }

    /// Relaxes, writes the values to `x`, and answers the norm of each column's residual.
    fn relax(mut self, x: &mut [f64]) -> Vec<f64> {
        let width = self.references.len();
        let mut sum = vec![0.0; width];
        self.fill_new_nodes(&mut sum);
        let mut left = self.residuals();
        let mut over = 1.0;
        for round in 1..=ROUNDS {
            match width {
                1 => self.sweep::<1>(over),
                2 => self.sweep::<2>(over),
                3 => self.sweep::<3>(over),
                4 => self.sweep::<4>(over),
                _ => self.sweep_columns(over, &mut sum),
            }
            // Chebyshev's factors (Golub and Varga 1961).
            over = match round {
                1 => 1.0 / (1.0 - RADIUS / 2.0),
                _ => 1.0 / (1.0 - RADIUS * over / 4.0),
            };
            if round % CHECK_INTERVAL == 0 {
                left = self.residuals();
                let is_enough = |(r, reference): (&f64, &f64)| *r <= SUFFICIENT * reference;
                if left.iter().zip(self.references).all(is_enough) {
                    break;
                }
            }
        }
        for (&n, row) in self.nodes[..self.relaxed].iter().zip(self.values.chunks(width)) {
            x[n as usize * width..(n as usize + 1) * width].copy_from_slice(row);
        }
        left
    }

    /// One round over the relaxed nodes, in as many columns as the compiler knows of: most of the time of an edit's fields is spent here.
    fn sweep<const W: usize>(&mut self, over: f64) {
        let values = self.values.as_chunks_mut::<W>().0;
        for i in 0..self.relaxed {
            let diagonal = self.diagonal[i];
            if diagonal <= 0.0 {
                continue;
            }
            let entries = self.offsets[i] as usize..self.offsets[i + 1] as usize;
            let mut sum = [0.0; W];
            for (&j, w) in self.neighbours[entries.clone()].iter().zip(&self.weights[entries]) {
                let row = &values[j as usize];
                (0..W).for_each(|c| sum[c] += w * row[c]);
            }
            let row = &mut values[i];
            (0..W).for_each(|c| row[c] += over * (sum[c] / diagonal - row[c]));
        }
    }

    /// The same in any number of columns.
    fn sweep_columns(&mut self, over: f64, sum: &mut [f64]) {
        let width = sum.len();
        for i in 0..self.relaxed {
            if self.diagonal[i] <= 0.0 {
                continue;
            }
            sum.fill(0.0);
            for (j, w) in self.edges(i) {
                let row = &self.values[j * width..(j + 1) * width];
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += w * v);
            }
            let row = &mut self.values[i * width..(i + 1) * width];
            let diagonal = self.diagonal[i];
            row.iter_mut()
                .zip(&*sum)
                .for_each(|(v, s)| *v += over * (s / diagonal - *v));
        }
    }

    /// Gives new nodes the mean of those around that have values; from the old ones inwards.
    fn fill_new_nodes(&mut self, sum: &mut [f64]) {
        let width = sum.len();
        for i in 0..self.relaxed {
            if self.known[i] {
                continue;
            }
            sum.fill(0.0);
            let mut weight = 0.0;
            for (j, w) in self.edges(i).filter(|&(j, _)| self.known[j]) {
                let row = &self.values[j * width..(j + 1) * width];
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += w * v);
                weight += w;
            }
            if weight > 0.0 {
                let row = &mut self.values[i * width..(i + 1) * width];
                row.iter_mut().zip(&*sum).for_each(|(v, s)| *v = s / weight);
                self.known[i] = true;
            }
        }
    }

    /// The norm of each column's residual.
    fn residuals(&self) -> Vec<f64> {
        let width = self.references.len();
        let mut squares = vec![0.0; width];
        for i in 0..self.judged {
            for (c, square) in squares.iter_mut().enumerate() {
                let flow: f64 = self.edges(i).map(|(j, w)| w * self.values[j * width + c]).sum();
                let r = flow - self.diagonal[i] * self.values[i * width + c];
                *square += r * r;
            }
        }
        squares.into_iter().map(f64::sqrt).collect()
    }
}

/// Adds neighbours of `nodes[begin..]` that `wanted` lets in and have no number; answers where they begin.
fn add_neighbours(
    graph: &WeightedGraph<'_>,
    nodes: &mut Vec<u32>,
    numbers: &mut [u32],
    begin: usize,
    wanted: impl Fn(usize) -> bool,
) -> usize {
    let end = nodes.len();
    for k in begin..end {
        for &j in graph.neighbours_of(nodes[k] as usize) {
            if numbers[j as usize] == NO_ROW && wanted(j as usize) {
                numbers[j as usize] = nodes.len() as u32;
                nodes.push(j);
            }
        }
    }
    end
}

/// Notes where nodes are.
fn number_nodes(numbers: &mut [u32], nodes: &[u32]) {
    for (k, &n) in (0u32..).zip(nodes) {
        numbers[n as usize] = k;
    }
}

/// Neighbours of vertex `i` and the weights of the edges to them.
fn edges_of<'g>(graph: &'g WeightedGraph<'_>, i: usize) -> impl Iterator<Item = (usize, f64)> + use<'g> {
    let entries = graph.offsets[i] as usize..graph.offsets[i + 1] as usize;
    entries.map(|e| {
        (
            graph.neighbours[e] as usize,
            graph.weights.map_or(1.0, |w| f64::from(w[e])),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::BoxLattice;

    #[test]
    fn a_column_is_relaxed_alike_whatever_stands_beside_it() {
        let block = BoxLattice::new(20, 9, 9).weighted();
        let n = block.positions.len();
        let end = |i: usize| block.positions[i][0];
        let fixed: Vec<bool> = (0..n).map(|i| end(i) == 0.0 || end(i) == 19.0).collect();
        let changed: Vec<u32> = (0..n as u32)
            .filter(|&i| (9.0..11.0).contains(&end(i as usize)))
            .collect();
        let is_new = |i: usize| changed.binary_search(&(i as u32)).is_ok();
        let relaxed = |columns: usize| {
            let mut x: Vec<f64> = (0..n)
                .flat_map(|i| vec![if is_new(i) { 0.0 } else { end(i) / 19.0 }; columns])
                .collect();
            let relaxation = LocalRelaxation {
                graph: block.view(),
                fixed: &fixed,
                has_value: &|i| !is_new(i),
                references: &vec![1.0; columns],
            };
            let left = relaxation.relax_around(changed.clone(), &mut x);
            (x, left)
        };
        let (alone, left) = relaxed(1);
        let middle = changed[0] as usize;
        assert!(
            (alone[middle] - end(middle) / 19.0).abs() < 0.05 && left[0] < 0.05,
            "{} {left:?}",
            alone[middle]
        );
        for columns in 2..7 {
            let (x, each) = relaxed(columns);
            assert!(
                each.iter().all(|r| *r == left[0]),
                "{columns} columns: {each:?}, alone {left:?}"
            );
            let is_same = |(row, value): (&[f64], &f64)| row.iter().all(|v| v.to_bits() == value.to_bits());
            assert!(x.chunks(columns).zip(&alone).all(is_same), "{columns} columns");
        }
    }
}
