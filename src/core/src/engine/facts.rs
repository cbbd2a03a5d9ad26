//! What a deformer reports about its model, solver, handles and shapes.

use crate::asset::{Format, Primitive};
use glam::DVec3;

/// What a deformer reports about model, solver and handles.
#[derive(Debug, Clone, PartialEq)]
pub struct DeformerFacts {
    /// The model as it was read, and its sizes now.
    pub model: ModelFacts,
    /// The runs of render vertices.
    pub primitives: Vec<Primitive>,
    /// What the solver works on.
    pub solver: SolverFacts,
    /// The handles in force.
    pub handles: Vec<HandleFacts>,
    /// What was noticed about model and handles.
    pub warnings: Vec<DeformerWarning>,
}

/// The model as it was read, and its sizes now.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelFacts {
    /// Its format.
    pub format: Format,
    /// Bytes of its files.
    pub file_bytes: u64,
    /// SHA-256 of the main file, lower-case hexadecimal.
    pub sha256: String,
    /// Vertices and triangles.
    pub counts: MeshCounts,
}

/// The sizes of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MeshCounts {
    /// Render vertices.
    pub vertices: u32,
    /// Triangles.
    pub faces: u32,
}

/// What the solver works on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SolverFacts {
    /// Vertices after welding.
    pub solver_vertices: u32,
    /// Vertices of the graph: solver vertices, shell and lattice.
    pub graph_vertices: u32,
    /// Edges of the graph, each counted once.
    pub graph_edges: u64,
    /// Connected parts of the mesh.
    pub components: u32,
    /// What holds them together.
    pub ties: TieFacts,
    /// Vertices and edges of each level of the hierarchy, finest first.
    pub levels: Vec<(u32, u64)>,
    /// Bytes held by the deformer.
    pub byte_size: u64,
}

/// What holds the connected parts of a model together.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TieFacts {
    /// Edges that tie parts to each other, each counted once.
    pub ties: u64,
    /// Parts that neither ties nor a common inside join to any other, where there are several parts.
    pub loose_parts: u32,
    /// The largest of them, by falling number of vertices.
    pub loose: Vec<LoosePart>,
}

/// A connected part that nothing joins to any other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoosePart {
    /// Its number among the connected parts.
    pub component: u32,
    /// Its render vertices.
    pub vertices: u32,
    /// The primitive that its first vertex belongs to.
    pub primitive: u32,
    /// The name of that primitive.
    pub name: String,
}

/// A handle in force.
#[derive(Debug, Clone, PartialEq)]
pub struct HandleFacts {
    /// Its name.
    pub id: String,
    /// Render vertices that it holds, after later handles took theirs.
    pub vertices: u32,
    /// Nodes inside the model that it holds, likewise.
    pub interior_nodes: u32,
    /// The default pivot: the mean rest position of its solver vertices; of its inside nodes when it holds no vertex.
    pub centroid: DVec3,
}

/// Something that a user should know; nothing was refused for it.
#[derive(Debug, Clone, PartialEq)]
pub struct DeformerWarning {
    /// A stable kebab-case code, such as "non-manifold-edges".
    pub code: String,
    /// What it is, for people.
    pub message: String,
    /// Where it is.
    pub place: WarningPlace,
}

/// Where the thing is that a warning is about.
#[derive(Debug, Clone, PartialEq)]
pub enum WarningPlace {
    /// Vertices, positions or a place in a file, in words; empty where there is nothing to say.
    Text(String),
    /// Places of the surface, with a render vertex at each.
    Vertices {
        /// The places in words.
        text: String,
        /// A render vertex at each place, in their order.
        vertices: Vec<u32>,
    },
    /// Places on the rest shape, model space.
    Points {
        /// The places in words.
        text: String,
        /// Where they are.
        points: Vec<DVec3>,
    },
    /// The handles with these indices.
    Handles(Vec<usize>),
    /// The region of interest.
    RegionOfInterest,
}

/// A shape against the rest shape, over the model's triangles.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct QualityReport {
    /// Root of the mean square of (length / rest length - 1) over edges.
    pub edge_rms: f64,
    /// Relative change of the enclosed volume; 0 for models without an inside.
    pub volume_change: f64,
    /// Whether the surface is open, so that it encloses no volume that could change.
    pub open_surface: bool,
    /// Relative change of the area.
    pub area_change: f64,
    /// Triangles whose normal opposes the rest normal as carried by the local rotation.
    pub flipped_triangles: u32,
    /// Largest singular value of any triangle's Jacobian.
    pub max_stretch: f64,
    /// Triangles with an edge, longer than 2 % of the diagonal, whose ends are turned against each other by more than 30°:
    /// they are too large to show the bend.
    pub faces_too_large: u32,
    /// Pairs of triangles that cross, when asked for.
    pub self_intersections: Option<u32>,
}

impl DeformerWarning {
    /// Makes a warning about a place described in words.
    pub fn new(code: impl Into<String>, message: impl Into<String>, place: impl Into<String>) -> Self {
        Self {
            code: code.into(),
            message: message.into(),
            place: WarningPlace::Text(place.into()),
        }
    }

    /// Makes a warning about handles.
    pub(super) fn about_handles(code: &str, message: String, handles: impl Into<Vec<usize>>) -> Self {
        Self {
            code: code.into(),
            message,
            place: WarningPlace::Handles(handles.into()),
        }
    }
}

/// Turns a count into the number that reports carry.
pub(super) fn count_u32(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}
