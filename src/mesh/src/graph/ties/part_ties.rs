//! How parts are to be tied, and what a graph remembers of its ties.

use crate::Components;
use std::sync::Arc;

/// A vertex and the triangle of another part that it is tied to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TieAnchor {
    /// The vertex that is tied.
    pub vertex: u32,
    /// The corners of the triangle that its nearest place lies on.
    pub corners: [u32; 3],
    /// What the edges to these corners weigh: together as much as the tie, shared out by how near the place is to each;
    /// 0 where there is no edge.
    pub weights: [f32; 3],
}

/// How far vertices look for other parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::graph) struct TieReach {
    /// The shortest reach, model units.
    pub(in crate::graph) least: f64,
    /// The longest one; both are the same when a distance was asked for.
    pub(in crate::graph) most: f64,
}

/// What ties joined, as it was without them.
#[derive(Debug, Clone, PartialEq, Default)]
pub(in crate::graph) struct UntiedGraph {
    /// The connected component of each node.
    pub(in crate::graph) component: Vec<u32>,
    /// How many there are.
    pub(in crate::graph) components: usize,
    /// For each, whether it has shell or lattice nodes.
    pub(in crate::graph) component_has_volume: Vec<bool>,
    /// Whether edges had weights.
    pub(in crate::graph) weighted: bool,
}

/// The ties of a graph, and what it takes to have it without them.
#[derive(Debug, Clone, PartialEq)]
pub struct PartTies {
    /// By rising vertex, at most three a vertex.
    pub(in crate::graph) anchors: Vec<TieAnchor>,
    /// How many edges they are.
    pub(in crate::graph) edges: usize,
    pub(in crate::graph) reach: TieReach,
    pub(in crate::graph) untied: UntiedGraph,
}

impl PartTies {
    /// Vertices with the triangles that they are tied to, by rising vertex.
    pub fn anchors(&self) -> &[TieAnchor] {
        &self.anchors
    }

    /// How many edges tie parts, each counted once.
    pub fn edge_count(&self) -> usize {
        self.edges
    }

    /// For each component of the graph without ties, in the order of their smallest nodes, whether it has nodes inside.
    pub fn component_has_volume(&self) -> &[bool] {
        &self.untied.component_has_volume
    }

    /// The component that each node would be of without ties.
    pub fn untied_component(&self) -> &[u32] {
        &self.untied.component
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.anchors.capacity() * size_of::<TieAnchor>()
            + self.untied.component.capacity() * size_of::<u32>()
            + self.untied.component_has_volume.capacity()
    }
}

impl TieAnchor {
    /// The corners that it is tied to, with what these edges weigh.
    pub fn weighted_corners(&self) -> impl Iterator<Item = (u32, f32)> + use<> {
        self.corners.into_iter().zip(self.weights).filter(|e| e.1 > 0.0)
    }
}

/// Among [`TieFamilies::Of`]: a vertex of a part that gets no ties.
pub const LOOSE: u32 = u32::MAX;

/// How parts of a mesh are tied to each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TieOptions {
    /// How far apart places of two parts may lie to be tied, model units. By default half the length of the edges around,
    /// at least 0.5 % and at most 2 % of the diagonal of the mesh's bounding box.
    pub distance: Option<f64>,
    /// Which parts may be tied to each other.
    pub families: TieFamilies,
}

/// Which parts of a mesh may be tied to each other: those of different families.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum TieFamilies {
    /// Each connected part is a family of its own.
    #[default]
    EachPart,
    /// All parts are of one family: nothing is tied.
    One,
    /// The family of each vertex of the mesh, or [`LOOSE`]. All vertices of a connected part are of one family, and so may be
    /// several parts, such as the pieces of a cut.
    Of(Arc<Vec<u32>>),
}

impl TieOptions {
    /// The family of each vertex; `None` where all are of one.
    pub(super) fn family_of_vertex<'a>(&'a self, parts: &'a Components) -> Option<&'a [u32]> {
        match &self.families {
            TieFamilies::One => None,
            TieFamilies::EachPart => (parts.count > 1).then_some(&parts.of_vertex),
            TieFamilies::Of(families) => Some(families),
        }
    }
}
