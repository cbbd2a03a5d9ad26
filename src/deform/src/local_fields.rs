//! Fields of many handles: each is solved for around its handle alone, as far as it is more than next to nothing.
//!
//! Between many handles a field fades within a few distances between neighbours. Sixteen handles that are near each other are
//! solved for together, on the nodes around them, with 0 given further away. They begin as 1 on the nodes that are nearest to
//! each, so that all of them sum to 1 from the start; nodes are relaxed in turn (successive over-relaxation, Young 1954), and where
//! a field has reached the border of its nodes, more of them are taken in. Handles whose fields do not fade are left to the solver.
//!
//! With 0 given around, a field is nowhere above what it would be on the whole graph (maximum principle), and all fields sum
//! to 1. So what the fields at a node lack of 1 is the sum of all their errors there.

use crate::body::DeformableBody;
use crate::handles::ownership::{NodeOwnership, UNHELD};
use glam::DVec3;
use std::collections::VecDeque;

/// Handles that are solved for together.
pub(crate) const LANES: usize = 16;
type LaneValues = [f32; LANES];

/// A field is next to nothing below this.
pub(crate) const NEXT_TO_NOTHING: f32 = 3e-4;
/// Nodes are relaxed until no value changes by more than this.
const STILL: f32 = 2e-4;
/// Nodes whose values changed by less than this are only visited every few times.
const QUIET: f32 = 2e-5;
const QUIET_VISITS: usize = 4;
/// Relaxations between two looks at the border; the last one visits all nodes.
const SWEEPS: usize = 8;
/// Looks at the border at most.
const ROUNDS: usize = 32;
/// The largest factor of relaxation.
const LARGEST_FACTOR: f64 = 1.97;
/// What the mean number of steps of a random walk until it ends at a handle is, for each node that is nearest to one.
const STEPS_A_NODE: f64 = 1.5;
/// No node.
const NONE: u32 = u32::MAX;

/// Nodes, holds and values.
pub(crate) type FieldEntries = Vec<(u32, u32, f32)>;

/// Which hold is nearest to each free node, counted in edges.
pub(crate) struct HoldCells {
    /// By node: the hold, or [`UNHELD`].
    nearest: Vec<u32>,
    /// By hold: the free nodes that it is nearest to, and where its nodes are.
    cells: Vec<Vec<u32>>,
    centers: Vec<DVec3>,
}

impl HoldCells {
    /// Those of `holds` holds.
    pub fn find(body: &DeformableBody, ownership: &NodeOwnership, holds: usize) -> Self {
        let mut nearest = ownership.hard.to_vec();
        let mut pulled = vec![0.0f64; if ownership.soft.is_empty() { 0 } else { body.nodes() }];
        let mut sums = vec![(DVec3::ZERO, 0.0); holds];
        let mut count = |hold: u32, node: usize| {
            let (sum, count) = &mut sums[hold as usize];
            *sum += body.graph.positions[node] - body.origin;
            *count += 1.0;
        };
        for (node, &hold) in nearest.iter().enumerate().filter(|(_, k)| **k != UNHELD) {
            count(hold, node);
        }
        for &(node, hold, stiffness) in ownership.soft.iter() {
            count(hold, node as usize);
            if stiffness > pulled[node as usize] {
                pulled[node as usize] = stiffness;
                nearest[node as usize] = hold;
            }
        }
        let mut queue: VecDeque<u32> = (0u32..)
            .zip(&nearest)
            .filter(|(_, k)| **k != UNHELD)
            .map(|(n, _)| n)
            .collect();
        while let Some(node) = queue.pop_front() {
            for &other in body.graph.row(node) {
                if nearest[other as usize] == UNHELD {
                    nearest[other as usize] = nearest[node as usize];
                    queue.push_back(other);
                }
            }
        }
        let mut cells = vec![Vec::new(); holds];
        for (node, &hold) in (0u32..).zip(&nearest) {
            if hold != UNHELD && ownership.hard[node as usize] == UNHELD {
                cells[hold as usize].push(node);
            }
        }
        Self {
            nearest,
            cells,
            centers: sums
                .into_iter()
                .map(|(sum, count)| sum / f64::max(count, 1.0))
                .collect(),
        }
    }

    /// Divides holds into blocks that lie together, at most [`LANES`] in each: in halves along the longest side, again and again.
    pub fn blocks(&self, mut holds: Vec<usize>) -> Vec<Vec<usize>> {
        let mut blocks = Vec::new();
        self.divide(&mut holds, &mut blocks);
        blocks
    }

    fn divide(&self, holds: &mut [usize], blocks: &mut Vec<Vec<usize>>) {
        if holds.len() <= LANES {
            blocks.push(holds.to_vec());
            return;
        }
        let at = |k: &usize| self.centers[*k];
        let low = holds.iter().map(at).fold(DVec3::INFINITY, DVec3::min);
        let size = holds.iter().map(at).fold(DVec3::NEG_INFINITY, DVec3::max) - low;
        let axis = (0..3).fold(0, |best, c| if size[c] > size[best] { c } else { best });
        holds.sort_by(|a, b| at(a)[axis].total_cmp(&at(b)[axis]).then(a.cmp(b)));
        // Whole blocks on the lower side.
        let middle = holds.len().div_ceil(2 * LANES) * LANES;
        let (lower, upper) = holds.split_at_mut(middle);
        self.divide(lower, blocks);
        self.divide(upper, blocks);
    }
}

/// Solves for the fields of a block of holds. `None` for fields that do not fade, or too slowly.
pub(crate) fn solve_block(
    body: &DeformableBody,
    ownership: &NodeOwnership,
    first_pulls: &[u32],
    cells: &HoldCells,
    holds: &[usize],
) -> Option<FieldEntries> {
    let own: usize = holds.iter().map(|&k| cells.cells[k].len()).sum();
    let mean = own as f64 / holds.len() as f64;
    let radius = (mean / std::f64::consts::PI).sqrt();
    let rings = |part: f64| ((radius * part) as usize).max(2);
    let graph = BlockGraph {
        body,
        ownership,
        first_pulls,
        holds,
    };

    let mut rows = BlockRows::new(body.nodes());
    holds
        .iter()
        .for_each(|&k| cells.cells[k].iter().for_each(|&n| rows.take(n)));
    rows.values.resize(rows.nodes.len(), [0.0; LANES]);
    for (row, &node) in rows.values.iter_mut().zip(&rows.nodes) {
        let lane = holds.iter().position(|&k| k as u32 == cells.nearest[node as usize]);
        lane.into_iter().for_each(|lane| row[lane] = 1.0);
    }
    let all: Vec<u32> = (0..rows.nodes.len() as u32).collect();
    rows.grow(&graph, all, rings(2.0));
    let mut factor = best_factor(1.0 - 1.0 / (STEPS_A_NODE * mean).max(2.0));
    for _ in 0..ROUNDS {
        rows.connect(&graph);
        let mut changes = [0.0f32; SWEEPS];
        for (visit, change) in changes.iter_mut().enumerate() {
            *change = rows.relax(factor as f32, (visit + 1) % QUIET_VISITS == 0);
        }
        let reached = rows.reached_border();
        if reached.is_empty() && changes[SWEEPS - 1] < STILL {
            return Some(rows.entries(holds));
        }
        // Slower than the factor lets it be at best: what keeps it back has a larger part of neighbours' values than was guessed.
        let [.., before, last] = changes;
        let ratio = f64::from(last / before);
        if ratio > factor - 1.0 && ratio < 1.0 {
            let square = (ratio + factor - 1.0).powi(2) / (ratio * factor * factor);
            factor = best_factor(square.sqrt()).clamp(factor, LARGEST_FACTOR);
        }
        rows.grow(&graph, reached, rings(0.5));
    }
    None
}

/// How far relaxation best goes beyond the mean of neighbours where each visit of all nodes keeps this part of an error if it goes
/// just there (Young 1954).
fn best_factor(kept: f64) -> f64 {
    2.0 / (1.0 + (1.0 - kept * kept).max(0.0).sqrt())
}

/// The graph as a block of holds sees it.
struct BlockGraph<'a> {
    body: &'a DeformableBody,
    ownership: &'a NodeOwnership,
    /// Where each node's soft pulls begin; empty without any.
    first_pulls: &'a [u32],
    holds: &'a [usize],
}

impl BlockGraph<'_> {
    fn lane_of(&self, hold: u32) -> Option<usize> {
        self.holds.iter().position(|&k| k as u32 == hold)
    }

    fn is_free(&self, node: u32) -> bool {
        self.ownership.hard[node as usize] == UNHELD
    }
}

/// The nodes around a block of holds, and its fields there.
struct BlockRows {
    /// The nodes, in the order in which they were taken in.
    nodes: Vec<u32>,
    /// By node of the graph: its row, or [`NONE`].
    row_of: Vec<u32>,
    /// Where the edges of each row begin, and the end.
    first: Vec<u32>,
    /// Rows at the other ends of edges, and what part of the row's weight each has.
    edges: Vec<(u32, f32)>,
    /// By row: which of `given` is added, or [`NONE`].
    given_of: Vec<u32>,
    given: Vec<LaneValues>,
    /// Rows with neighbours that are free and no rows.
    border: Vec<u32>,
    values: Vec<LaneValues>,
    /// By row: whether its values hardly changed when it was last visited.
    quiet: Vec<bool>,
}

impl BlockRows {
    fn new(nodes: usize) -> Self {
        Self {
            nodes: Vec::new(),
            row_of: vec![NONE; nodes],
            first: Vec::new(),
            edges: Vec::new(),
            given_of: Vec::new(),
            given: Vec::new(),
            border: Vec::new(),
            values: Vec::new(),
            quiet: Vec::new(),
        }
    }

    fn take(&mut self, node: u32) {
        self.row_of[node as usize] = self.nodes.len() as u32;
        self.nodes.push(node);
    }

    /// Takes in the free nodes that are at most so many edges from these rows.
    fn grow(&mut self, graph: &BlockGraph<'_>, mut front: Vec<u32>, rings: usize) {
        for _ in 0..rings {
            let mut next = Vec::new();
            for row in front {
                for &other in graph.body.graph.row(self.nodes[row as usize]) {
                    if self.row_of[other as usize] == NONE && graph.is_free(other) {
                        self.take(other);
                        next.push(self.nodes.len() as u32 - 1);
                    }
                }
            }
            front = next;
        }
        self.values.resize(self.nodes.len(), [0.0; LANES]);
    }

    /// Finds the edges of all rows.
    fn connect(&mut self, graph: &BlockGraph<'_>) {
        let Self {
            nodes,
            row_of,
            first,
            edges,
            given_of,
            given,
            border,
            quiet,
            ..
        } = self;
        [&mut *first, given_of, border].into_iter().for_each(Vec::clear);
        quiet.clear();
        quiet.resize(nodes.len(), false);
        edges.clear();
        given.clear();
        first.push(0);
        for (row, &node) in nodes.iter().enumerate() {
            let (mut sum, mut own) = (0.0, [0.0f32; LANES]);
            let (mut is_given, mut is_border) = (false, false);
            let begin = edges.len();
            for (other, weight) in graph.body.edges(node as usize) {
                sum += weight;
                let hold = graph.ownership.hard[other];
                if hold == UNHELD {
                    match row_of[other] {
                        NONE => is_border = true,
                        other => edges.push((other, weight as f32)),
                    }
                } else if let Some(lane) = graph.lane_of(hold) {
                    own[lane] += weight as f32;
                    is_given = true;
                }
            }
            if let [from, to, ..] = graph.first_pulls.get(node as usize..).unwrap_or(&[]) {
                for &(_, hold, stiffness) in &graph.ownership.soft[*from as usize..*to as usize] {
                    sum += stiffness;
                    if let Some(lane) = graph.lane_of(hold) {
                        own[lane] += stiffness as f32;
                        is_given = true;
                    }
                }
            }
            let part = (1.0 / sum) as f32;
            edges[begin..].iter_mut().for_each(|e| e.1 *= part);
            first.push(edges.len() as u32);
            given_of.push(if is_given { given.len() as u32 } else { NONE });
            if is_given {
                given.push(own.map(|v| v * part));
            }
            if is_border {
                border.push(row as u32);
            }
        }
    }

    /// Brings the rows in turn nearer to the mean of their neighbours, or beyond it by `factor`: `all` of them, or those that are not
    /// quiet. Returns the largest change.
    fn relax(&mut self, factor: f32, all: bool) -> f32 {
        let mut most = 0.0f32;
        for row in 0..self.nodes.len() {
            if !all && self.quiet[row] {
                continue;
            }
            let mut mean = match self.given_of[row] {
                NONE => [0.0; LANES],
                given => self.given[given as usize],
            };
            for &(other, part) in &self.edges[self.first[row] as usize..self.first[row + 1] as usize] {
                let other = &self.values[other as usize];
                for lane in 0..LANES {
                    mean[lane] += part * other[lane];
                }
            }
            let own = &mut self.values[row];
            let mut changes = [0.0f32; LANES];
            for lane in 0..LANES {
                let change = factor * (mean[lane] - own[lane]);
                own[lane] += change;
                changes[lane] = change.abs();
            }
            let change = changes.into_iter().fold(0.0, |a, b| if b > a { b } else { a });
            self.quiet[row] = change < QUIET;
            most = most.max(change);
        }
        most
    }

    /// The rows at the border that a field has reached.
    fn reached_border(&self) -> Vec<u32> {
        let reaches = |row: &&u32| self.values[**row as usize].iter().any(|v| *v > NEXT_TO_NOTHING);
        self.border.iter().filter(reaches).copied().collect()
    }

    /// What is more than next to nothing.
    fn entries(&self, holds: &[usize]) -> FieldEntries {
        let mut entries = Vec::new();
        for (values, &node) in self.values.iter().zip(&self.nodes) {
            for (&hold, &value) in holds.iter().zip(values) {
                if value > NEXT_TO_NOTHING {
                    entries.push((node, hold as u32, value));
                }
            }
        }
        entries
    }
}
