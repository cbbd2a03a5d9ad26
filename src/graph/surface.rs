//! The graph of a mesh alone.

use super::assemble::{Inner, assemble};
use super::{Graph, Stats, Weights};
use crate::mesh::{Adjacency, Components, Mesh};

/// The mesh's vertices and edges as a graph, for open surfaces and for callers that want no volume graph.
///
/// Time and memory are linear in the number of triangles.
pub fn surface(mesh: &Mesh, weights: Weights) -> Graph {
    let adjacency = Adjacency::build(mesh.positions.len(), &mesh.triangles);
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    assemble(
        mesh,
        &adjacency,
        &parts,
        Inner::default(),
        weights,
        Stats::default(),
        None,
    )
}
