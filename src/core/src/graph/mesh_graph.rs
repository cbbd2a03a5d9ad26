//! The graph itself, and facts about it.

use crate::graph::recipe::GraphRecipe;
use crate::graph::ties::part_ties::PartTies;
use glam::DVec3;

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
    /// What [`resample`] needs to follow an edit of the mesh.
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
        &self.neighbours[self.offsets[node as usize] as usize..self.offsets[node as usize + 1] as usize]
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
