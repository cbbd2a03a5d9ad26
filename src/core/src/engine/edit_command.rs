//! Edits of the topology as a program asks for them, and what they came to.

use super::facts::{DeformerWarning, MeshCounts};
use super::handle::HandleSet;
use super::pose::HandlePoses;
use super::region::{Plane, Region};
use super::settings::SolveSettings;
use super::shape::ModelShape;
use crate::asset::{FileSet, Format};
use crate::edit::{KeptSide, SubdivisionScheme};
use glam::{DMat4, DVec3};

/// An operation that changes the topology. What has no region takes the whole model.
#[derive(Debug, Clone)]
pub enum Edit {
    /// Cuts the surface.
    Cut {
        /// Where it is cut.
        along: CutLine,
        /// Which sides stay.
        keep: KeptSide,
        /// Whether the cut is closed by a cap.
        fill: bool,
    },
    /// Splits triangles.
    Subdivide {
        /// Where.
        region: Option<Region>,
        /// Where the new vertices lie.
        scheme: SubdivisionScheme,
    },
    /// Splits triangles that are too large for the bend between handles.
    SubdivideForPose {
        /// Where.
        region: Option<Region>,
    },
    /// Removes triangles while keeping the shape.
    Decimate {
        /// Where.
        region: Option<Region>,
        /// The share of triangles to keep, between 0 and 1.
        ratio: f64,
    },
    /// Removes a region.
    Delete {
        /// What is removed.
        region: Region,
        /// Whether the hole is closed.
        fill: bool,
    },
    /// Closes holes.
    Fill {
        /// Where; `None` closes all.
        region: Option<Region>,
    },
    /// Evens out triangles.
    Remesh(RemeshCommand),
    /// Adds another model.
    Merge(Box<ModelMerge>),
    /// Inserts a polyline into the surface as edges.
    InsertCurve {
        /// The points; each is projected to the nearest place of the surface.
        points: Vec<DVec3>,
        /// Whether the line returns to its first point.
        closed: bool,
    },
    /// Makes one vertex of vertices that are close to each other.
    Weld {
        /// The largest distance, in model units.
        tolerance: f64,
    },
}

/// How triangles are evened out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RemeshCommand {
    /// Where.
    pub region: Option<Region>,
    /// The edge length to reach; `None` takes it from the rest shape, where stretch or aspect asks for it.
    pub edge_length: Option<f64>,
    /// As [`RemeshOptions::max_deviation`](crate::edit::RemeshOptions::max_deviation).
    pub max_deviation: Option<f64>,
    /// As [`RemeshOptions::sharp_degrees`](crate::edit::RemeshOptions::sharp_degrees); `None`:
    /// [`SHARP_DEGREES`](crate::edit::SHARP_DEGREES).
    pub sharp_degrees: Option<f64>,
}

/// Where a cut goes.
#[derive(Debug, Clone, PartialEq)]
pub enum CutLine {
    /// Through a plane.
    Plane(Plane),
    /// Along a line drawn on the surface; its points are projected to the nearest place.
    Polyline {
        /// The points of the line.
        points: Vec<DVec3>,
        /// Whether the line returns to its first point.
        closed: bool,
    },
    /// Along edges from vertex to vertex.
    Path {
        /// Render vertices, each joined to the next by an edge or the shortest way along edges.
        vertices: Vec<u32>,
        /// Whether the path returns to its first vertex.
        closed: bool,
    },
}

/// The addition of another model.
#[derive(Debug, Clone)]
pub struct ModelMerge {
    /// The other model.
    pub files: FileSet,
    /// Whether the other model is that of a session, for the words of errors alone.
    pub from_session: bool,
    /// Its format; `None`: detected by its first bytes.
    pub format: Option<Format>,
    /// Where the other model is placed.
    pub own_from_other: DMat4,
    /// How both are joined.
    pub join: MergeJoin,
    /// The largest distance of boundary vertices that are welded; `None`: half the mean edge of the other model.
    pub tolerance: Option<f64>,
}

/// How two models are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MergeJoin {
    /// Matching boundaries are welded.
    Weld,
    /// Two boundary loops are stitched.
    Stitch,
    /// The other model stays a part of its own.
    Loose,
}

/// The kind of an edit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum EditKind {
    Cut,
    Subdivide,
    Decimate,
    Delete,
    Fill,
    Remesh,
    Merge,
    InsertCurve,
    Weld,
}

/// The shape on which an edit works.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EditedShape {
    /// The current shape, which becomes the rest shape; all handles get rest poses.
    Current,
    /// The rest shape; poses stay, and the result is solved with them.
    Rest,
}

/// An edit, and the state that it is to change.
pub struct EditCommand<'a> {
    /// What is to be done.
    pub edit: &'a Edit,
    /// On which shape.
    pub on: EditedShape,
    /// The current shape, one position per render vertex. Where the deformer
    /// [remembers](super::Deformer::remembers) it, graph and hierarchy can follow the edit; else they are built from nothing.
    pub shape: &'a ModelShape,
    /// The poses in force.
    pub poses: &'a HandlePoses,
    /// How the current shape was solved; `None` when it is the rest shape. An edit on the rest shape solves it again like this.
    pub settings: Option<&'a SolveSettings>,
}

/// The state after an edit.
#[derive(Debug, Clone)]
pub struct EditOutcome {
    /// What the edit did.
    pub report: EditReport,
    /// The handles in force, in the new numbers; already set.
    pub handles: HandleSet,
    /// Their poses.
    pub poses: HandlePoses,
    /// How the shape was solved, when it is not the rest shape.
    pub solved: Option<SolveSettings>,
    /// The shape after the edit.
    pub shape: ModelShape,
}

/// What an edit did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EditReport {
    /// Sizes before.
    pub before: MeshCounts,
    /// Sizes after.
    pub after: MeshCounts,
    /// Ids of handles that still hold vertices.
    pub handles_kept: Vec<String>,
    /// What was noticed.
    pub warnings: Vec<DeformerWarning>,
    /// The render vertices that are left, in rising runs. What no run names is gone or new.
    pub kept: Vec<KeptVertexRun>,
    /// Render vertices along an inserted curve, in order, one for each of its points.
    pub curve: Vec<u32>,
    /// Of a remesh: the largest distance between the surface before and after.
    pub deviation: f64,
    /// Digest of the positions after the edit.
    pub digest: String,
    /// Whether graph and hierarchy were repaired around the edit, not rebuilt.
    pub repaired: bool,
}

/// Render vertices that an edit left: `count` of them, from number `was` on before, are numbered from `now` on after it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeptVertexRun {
    /// The first number before.
    pub was: u32,
    /// The first number after.
    pub now: u32,
    /// How many there are.
    pub count: u32,
}

impl Edit {
    /// Returns the kind of the edit.
    pub fn kind(&self) -> EditKind {
        match self {
            Self::Cut { .. } => EditKind::Cut,
            Self::Subdivide { .. } | Self::SubdivideForPose { .. } => EditKind::Subdivide,
            Self::Decimate { .. } => EditKind::Decimate,
            Self::Delete { .. } => EditKind::Delete,
            Self::Fill { .. } => EditKind::Fill,
            Self::Remesh(_) => EditKind::Remesh,
            Self::Merge(_) => EditKind::Merge,
            Self::InsertCurve { .. } => EditKind::InsertCurve,
            Self::Weld { .. } => EditKind::Weld,
        }
    }
}
