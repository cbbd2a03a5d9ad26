//! The graph of a mesh alone.

use crate::graph::assemble::{InteriorNodes, assemble};
use crate::graph::mesh_graph::{GraphStats, MeshGraph};
use crate::graph::weights::EdgeWeights;
use crate::mesh::{Adjacency, Components, Mesh};

/// The mesh's vertices and edges as a graph, for open surfaces and for callers that want no volume graph.
///
/// Time and memory are linear in the number of triangles.
pub fn surface(mesh: &Mesh, weights: EdgeWeights) -> MeshGraph {
    let adjacency = Adjacency::build(mesh.positions.len(), &mesh.triangles);
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    assemble(
        mesh,
        &adjacency,
        &parts,
        InteriorNodes::default(),
        weights,
        GraphStats::default(),
        None,
    )
}
