//! What a graph remembers of its ties.

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
    pub fn weighted_corners(&self) -> impl Iterator<Item = (u32, f32)> + '_ {
        self.corners.into_iter().zip(self.weights).filter(|e| e.1 > 0.0)
    }
}
