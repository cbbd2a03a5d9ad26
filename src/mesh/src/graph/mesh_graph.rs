//! The graph itself, facts about it, and how its nodes and weights were made as far as an edit of the mesh needs to know.

use crate::Adjacency;
use crate::graph::ties::part_ties::PartTies;
use glam::DVec3;
use std::ops::Range;

/// A symmetric weighted graph with positions.
///
/// Rows are stored back to back: the neighbours of node `i` are `neighbours[offsets[i]..offsets[i + 1]]`.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshGraph {
    /// Where each row starts, and one past the end of the last; one entry more than nodes.
    pub offsets: Vec<u32>,
    /// Neighbours row by row: rising, without repeats and without the node itself; each edge stands in both rows.
    pub neighbours: Vec<u32>,
    /// One positive weight per entry of `neighbours`, the same in both directions; `None` when all are 1.
    pub weights: Option<Vec<f32>>,
    /// Rest positions. The first `surface` are the solver vertices of the mesh, in order; then the shell; then the
    /// lattice.
    pub positions: Vec<DVec3>,
    /// Number of surface nodes.
    pub surface: usize,
    /// For each node a solver vertex: a surface node itself, the vertex that a shell node was moved from, for a
    /// lattice node the nearest vertex, or one almost as near.
    pub nearest_surface: Vec<u32>,
    /// The connected component of each node, numbered in the order of their smallest node. Each has surface nodes.
    pub component: Vec<u32>,
    /// How many components there are.
    pub components: usize,
    /// How the graph came about.
    pub stats: GraphStats,
    /// What [`resample`](crate::graph::resample) needs to follow an edit of the mesh.
    pub recipe: GraphRecipe,
    /// What holds parts of the mesh together; `None` where nothing does, or there is one part only.
    pub ties: Option<PartTies>,
}

/// Facts about a graph.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GraphStats {
    /// Nodes of the inner shell.
    pub shell_nodes: usize,
    /// Nodes of the lattice.
    pub lattice_nodes: usize,
    /// Edges across places that are too thin for a lattice.
    pub struts: usize,
    /// Side of a lattice cell; 0 without a volume graph.
    pub interval: f64,
    /// The side that would have been used without a limit of nodes.
    pub wanted_interval: f64,
    /// Largest distance that shell nodes were moved inwards; 0 without a volume graph.
    pub shell_offset: f64,
    /// Volume of the inside, measured or (for open or nested parts) sampled; 0 without a volume graph.
    pub enclosed_volume: f64,
    /// For each component, whether it has shell or lattice nodes, or struts.
    pub component_has_volume: Vec<bool>,
}

impl MeshGraph {
    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.positions.len()
    }

    /// Number of edges, each counted once.
    pub fn edges(&self) -> usize {
        self.neighbours.len() / 2
    }

    /// The neighbours of `node`, rising.
    ///
    /// # Panics
    /// When `node` is out of range.
    pub fn row(&self, node: u32) -> &[u32] {
        &self.neighbours[self.entries(node)]
    }

    /// Where the row of `node` stands among all entries.
    ///
    /// # Panics
    /// When `node` is out of range.
    pub fn entries(&self, node: u32) -> Range<usize> {
        self.offsets[node as usize] as usize..self.offsets[node as usize + 1] as usize
    }

    /// Whether [`resample`](crate::graph::resample) may follow an edit of the mesh.
    pub fn follows_edits(&self) -> bool {
        let is_surface = self.surface == self.nodes() && self.stats.struts == 0;
        is_surface || self.recipe.inside.is_some() || self.recipe.shape_interval.is_some()
    }

    /// Moves all nodes by `way`; those of the surface to `surface`, which is there already.
    ///
    /// # Panics
    /// When `surface` has not as many places as the graph has surface nodes.
    pub fn move_nodes(&mut self, surface: &[DVec3], way: DVec3) {
        let (own, inner) = self.positions.split_at_mut(self.surface);
        own.copy_from_slice(surface);
        inner.iter_mut().for_each(|p| *p += way);
        if let Some(inside) = &mut self.recipe.inside {
            inside.origin += way;
        }
    }

    /// What an entry weighs.
    pub(super) fn weight(&self, entry: usize) -> f32 {
        self.weights.as_ref().map_or(1.0, |w| w[entry])
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let words = self.offsets.capacity()
            + self.neighbours.capacity()
            + self.weights.as_ref().map_or(0, Vec::capacity)
            + self.nearest_surface.capacity()
            + self.component.capacity();
        words * size_of::<u32>()
            + self.positions.capacity() * size_of::<DVec3>()
            + self.stats.component_has_volume.capacity()
            + self.recipe.byte_size()
            + self.ties.as_ref().map_or(0, PartTies::byte_size)
    }
}

/// What [`super::resample`] needs beside nodes and edges.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GraphRecipe {
    /// How cotangents of mesh edges are weighed; `None` with uniform weights.
    pub(super) cotangents: Option<CotangentScale>,
    /// How interior nodes of the paper's kind were placed; `None` where there are none.
    pub(super) inside: Option<InteriorRecipe>,
    /// Side of the smallest cell of the lattices that follow the shape; `None` where there are none, or where they are not to
    /// follow edits.
    pub(super) shape_interval: Option<f64>,
}

/// How interior nodes were placed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct InteriorRecipe {
    /// Place of grid A's node (0, 0, 0).
    pub(super) origin: DVec3,
    /// Side of a lattice cell.
    pub(super) interval: f64,
    /// Neighbours of a lattice node, 14 or 8.
    pub(super) valence: u32,
    /// Lattice nodes lie deeper than this.
    pub(super) depth: f64,
    /// Whether the inside of some part is known by the winding number of all its faces only.
    pub(super) soups: bool,
    /// For each solver vertex how far its copy is moved inwards where there is room, negative where the part is wound
    /// inside out; 0 on parts without interior nodes, which count as sheets.
    pub(super) reach: Vec<f32>,
    /// The passages along edges that parts with interior nodes lack to be closed, sorted.
    pub(super) open: Vec<[u32; 2]>,
}

impl GraphRecipe {
    /// Bytes held on the heap.
    pub(super) fn byte_size(&self) -> usize {
        self.inside.as_ref().map_or(0, |inside| {
            inside.reach.capacity() * size_of::<f32>() + inside.open.capacity() * size_of::<[u32; 2]>()
        })
    }
}

/// How much each edge of the mesh counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EdgeWeights {
    /// All the same, which the paper found sufficient (section 2.2).
    Uniform,
    /// Half the sum of the cotangents of the angles opposite to the edge, in terms of what it is among equilateral
    /// triangles, and at least 0.87. So the surface is as stiff whatever its triangles, and harmonic fields keep within their bounds.
    #[default]
    Cotangent,
    /// The same sum divided by its mean over the mesh, and limited to 0.001 … 1000: what sessions have that were stored before.
    CotangentOfMean,
}

/// Half the sum of the two cotangents of 60°, those of an edge between equilateral triangles.
const EQUILATERAL: f64 = 0.577_350_269_189_625_8;
/// The least weight, in terms of that. Edges opposite to obtuse angles would weigh little or less than nothing, and stretch most.
const LEAST: f64 = 0.87;
/// Cotangents beyond this, of angles under 0.6°, say nothing but that a face is thin.
const STEEPEST: f64 = 100.0;

/// What half sums of cotangents are multiplied by, and the least and the most that comes of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CotangentScale {
    factor: f64,
    limits: [f64; 2],
}

/// The cotangent weight of each edge of `adjacency`, with their scale; `None` where all weights are 1.
pub(super) fn cotangents(
    weights: EdgeWeights,
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    adjacency: &Adjacency,
) -> Option<(Vec<f32>, CotangentScale)> {
    let edges = adjacency.edges.iter();
    let half_sums = edges.map(|e| half_cotangent_sum(positions, triangles, adjacency, e.vertices));
    let half_sums: Vec<f64> = match weights {
        EdgeWeights::Uniform => return None,
        EdgeWeights::Cotangent | EdgeWeights::CotangentOfMean => half_sums.collect(),
    };
    let scale = if weights == EdgeWeights::Cotangent {
        CotangentScale {
            factor: 1.0 / EQUILATERAL,
            limits: [LEAST, f64::INFINITY],
        }
    } else {
        let mean = half_sums.iter().map(|w| w.max(0.0)).sum::<f64>() / half_sums.len().max(1) as f64;
        CotangentScale {
            // Only a mesh without any acute angle opposite to an edge has no positive mean, and then no cotangent helps.
            factor: if mean > 0.0 { 1.0 / mean } else { 0.0 },
            limits: [1e-3, 1e3],
        }
    };
    Some((half_sums.iter().map(|&sum| scale.weight_of(sum)).collect(), scale))
}

impl CotangentScale {
    fn weight_of(self, half_sum: f64) -> f32 {
        (half_sum * self.factor).clamp(self.limits[0], self.limits[1]) as f32
    }

    /// The weight of one edge, the smaller end first.
    pub(super) fn of_edge(
        self,
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        adjacency: &Adjacency,
        edge: [u32; 2],
    ) -> f32 {
        self.weight_of(half_cotangent_sum(positions, triangles, adjacency, edge))
    }
}

/// Half the sum of the cotangents of the angles opposite to the edge from `a` to `b`.
fn half_cotangent_sum(positions: &[DVec3], triangles: &[[u32; 3]], adjacency: &Adjacency, [a, b]: [u32; 2]) -> f64 {
    let opposite = adjacency.faces.of(a).iter().filter_map(|&f| {
        let t = triangles[f as usize];
        t.contains(&b)
            .then(|| t.into_iter().find(|&v| v != a && v != b))
            .flatten()
    });
    opposite
        .map(|c| 0.5 * cotangent([a, b, c].map(|v| positions[v as usize])))
        .sum()
}

/// Cotangent of the angle at the last corner; 0 for a face without area.
fn cotangent([a, b, c]: [DVec3; 3]) -> f64 {
    let (u, v) = (a - c, b - c);
    let sine = u.cross(v).length();
    if sine > 0.0 {
        (u.dot(v) / sine).clamp(-STEEPEST, STEEPEST)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cotangents_are_those_of_equilateral_triangles_or_0_87_of_them_at_least() {
        // An equilateral pair beside a very obtuse face.
        let h = 0.75f64.sqrt();
        let p = [[0., 0.], [1., 0.], [0.5, h], [1.5, h], [3., 0.001]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let faces = [[0, 1, 2], [2, 1, 3], [1, 4, 3]];
        let adjacency = Adjacency::build(5, &faces);
        let (w, _) = cotangents(EdgeWeights::Cotangent, &p, &faces, &adjacency).expect("cotangents");
        let of = |a: u32, b: u32| {
            w[adjacency
                .edges
                .iter()
                .position(|e| e.vertices == [a, b])
                .expect("an edge")]
        };
        assert!((of(1, 2) - 1.0).abs() < 1e-6, "an edge between equal triangles");
        assert!((of(0, 1) - 0.87).abs() < 1e-6, "an open edge has one angle opposite");
        assert!(w.iter().all(|&w| (0.87..=174.0).contains(&w)));
    }
}
