//! The graph of a mesh alone.

use crate::graph::assemble::{InteriorNodes, assemble};
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::weights::EdgeWeights;
use crate::mesh::{Adjacency, Components, Mesh};

/// Makes a graph of the mesh's vertices and edges alone, for open surfaces and for callers that want no volume graph.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::graph::{EdgeWeights, surface};
/// use pliant_core::mesh::{Mesh, Weld};
///
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
/// let square = Mesh::build(&positions, &[[0, 1, 2], [0, 2, 3]], Weld::Exact)?;
/// let graph = surface(&square, EdgeWeights::Uniform);
/// assert_eq!((graph.nodes(), graph.edges()), (4, 5));
/// assert_eq!(graph.row(0), [1, 2, 3]);
/// # Ok::<(), pliant_core::mesh::Error>(())
/// ```
///
/// Time and memory are linear in the number of triangles.
pub fn surface(mesh: &Mesh, weights: EdgeWeights) -> MeshGraph {
    let adjacency = Adjacency::build(mesh.positions.len(), &mesh.triangles);
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    assemble(mesh, &adjacency, &parts, InteriorNodes::default(), weights, None)
}
