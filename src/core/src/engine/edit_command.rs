//! Edits of the topology as a program asks for them, and what they came to.

use crate::edit::{CutPlane, KeptSide, PatchedSurface, SubdivisionScheme};
use crate::engine::facts::{DeformerWarning, MeshCounts};
use crate::engine::handle::{HandlePoses, HandleSet};
use crate::engine::other_model::OtherModel;
use crate::engine::region::{Plane, Region};
use crate::engine::settings::SolveSettings;
use crate::engine::shape::ModelShape;
use crate::engine::wrap::{WrapCommand, WrapReport};
use crate::mesh::NONE;
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
        /// A material of its own for the cap; `None`: it continues the surface.
        cap: Option<OwnCap>,
    },
    /// Splits triangles.
    Subdivide {
        /// Where.
        region: Option<Region>,
        /// Where the new vertices lie.
        scheme: SubdivisionScheme,
        /// Which edges stay sharp.
        creases: Creases,
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
        /// Flat caps with a material of their own; `None`: caps continue the surface.
        cap: Option<OwnCap>,
    },
    /// Evens out triangles.
    Remesh(RemeshCommand),
    /// Moves points to make a smoother surface, or more even triangles on the same one.
    Smooth(SmoothCommand),
    /// Adds another model.
    Merge(Box<ModelMerge>),
    /// Moves all points so that the surface lies on that of another model.
    Wrap(Box<WrapCommand>),
    /// Moves points as little as is needed for triangles not to cross.
    Unintersect(UnintersectCommand),
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
    /// Takes away parts that are small, and triangles that lie on others.
    Clean(CleanCommand),
    /// Makes a shape the rest pose, with vertices where they are given. Vertices and triangles stay.
    Adopt {
        /// Where, relative to [`DeformerFacts::origin`](super::DeformerFacts::origin): of each render vertex, or of each but those of
        /// passengers. Empty: the shape as it is.
        positions: Vec<[f32; 3]>,
    },
}

/// What a cleaning takes away.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CleanCommand {
    /// How many connected parts stay, those with the largest area; `None`: all.
    pub keep_largest: Option<u32>,
    /// Parts go whose area is a smaller share of the largest part's.
    pub smallest_share: Option<f64>,
    /// Parts go whose box has a shorter diagonal, in model units.
    pub smallest_size: Option<f64>,
    /// Triangles go whose corners are no further than this from those of an earlier one, whichever way round.
    pub duplicates_within: Option<f64>,
}

/// A cap with a primitive, a material and texture coordinates of its own.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnCap {
    /// The name of the material.
    pub material: String,
}

/// Which edges a subdivision leaves sharp.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Creases {
    /// As [`CreaseOptions::degrees`](crate::edit::CreaseOptions::degrees).
    pub degrees: Option<f64>,
    /// Edges between these pairs of render vertices.
    pub edges: Vec<[u32; 2]>,
    /// Edges between two primitives.
    pub between_primitives: bool,
    /// As [`CreaseOptions::sharpness`](crate::edit::CreaseOptions::sharpness); `None`: wholly sharp.
    pub sharpness: Option<f64>,
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

/// How points are moved.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SmoothCommand {
    /// Where.
    pub region: Option<Region>,
    /// What they are moved for.
    pub kind: SmoothKind,
    /// As [`SmoothOptions::iterations`](crate::edit::SmoothOptions::iterations); `None`:
    /// [`SMOOTHINGS`](crate::edit::SMOOTHINGS).
    pub iterations: Option<u32>,
    /// As [`SmoothOptions::strength`](crate::edit::SmoothOptions::strength); `None`:
    /// [`SMOOTH_STRENGTH`](crate::edit::SMOOTH_STRENGTH).
    pub strength: Option<f64>,
    /// As [`SmoothOptions::sharp_degrees`](crate::edit::SmoothOptions::sharp_degrees); `None`: a smoothing keeps no edge, a
    /// relaxation those above [`SHARP_DEGREES`](crate::edit::SHARP_DEGREES).
    pub sharp_degrees: Option<f64>,
}

/// What is asked of a model whose triangles cross.
#[derive(Debug, Clone, Default)]
pub struct UnintersectCommand {
    /// What of it stays where it is.
    pub fixed: Option<Region>,
    /// What surfaces that crossed keep from each other, model units; `None`: a tenth of the median edge around them.
    pub clearance: Option<f64>,
}

/// What points are moved for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SmoothKind {
    /// A smoother surface of the same volume.
    #[default]
    Smooth,
    /// More even triangles on the same surface.
    Relax,
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
    pub other: OtherModel,
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
    Smooth,
    Merge,
    InsertCurve,
    Weld,
    Clean,
    Adopt,
    Wrap,
    Unintersect,
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
    /// Of a subdivision with creases: the render vertices at the ends of the edges that they are now.
    pub creases: Vec<[u32; 2]>,
    /// Of a remesh or relaxation: the largest distance between the surface before and after.
    pub deviation: f64,
    /// Of a smoothing: by which part of the volume of the surface it has changed.
    pub volume_change: f64,
    /// Of a wrap: how well the surface lies on the target.
    pub wrap: Option<WrapReport>,
    /// Of a parting of what crosses: what became of it.
    pub unintersect: Option<UnintersectReport>,
    /// Digest of the positions after the edit.
    pub digest: String,
    /// Whether graph and hierarchy were repaired around the edit, not rebuilt.
    pub repaired: bool,
}

/// What became of triangles that cross.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct UnintersectReport {
    /// Pairs of triangles that crossed before.
    pub crossings_before: u64,
    /// Pairs that cross now.
    pub crossings: u64,
    /// Vertices of the surface, welded, that have moved.
    pub moved_vertices: u32,
    /// The longest way of one of them, as a share of the diagonal of the model.
    pub largest_move: f64,
    /// The root mean square of their ways, as a share of the diagonal.
    pub rms_move: f64,
    /// The longest way, median edges of the model.
    pub largest_move_in_edges: f64,
    /// The root mean square, median edges.
    pub rms_move_in_edges: f64,
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

impl EditKind {
    /// The name of the operation in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cut => "cut",
            Self::Subdivide => "subdivide",
            Self::Decimate => "decimate",
            Self::Delete => "delete",
            Self::Fill => "fill",
            Self::Remesh => "remesh",
            Self::Smooth => "smooth",
            Self::Merge => "merge",
            Self::InsertCurve => "insertCurve",
            Self::Weld => "weld",
            Self::Clean => "clean",
            Self::Adopt => "adopt",
            Self::Wrap => "wrap",
            Self::Unintersect => "unintersect",
        }
    }

    /// Whether it gives the shape that becomes the rest pose, and leaves all vertices and triangles as they are.
    pub fn gives_shape(self) -> bool {
        matches!(self, Self::Adopt | Self::Wrap | Self::Unintersect)
    }
}

impl Edit {
    /// The other model that it takes, if any.
    pub fn other_model(&self) -> Option<&OtherModel> {
        match self {
            Self::Merge(merge) => Some(&merge.other),
            Self::Wrap(wrap) => Some(&wrap.target),
            _ => None,
        }
    }

    /// The same, to be changed.
    pub fn other_model_mut(&mut self) -> Option<&mut OtherModel> {
        match self {
            Self::Merge(merge) => Some(&mut merge.other),
            Self::Wrap(wrap) => Some(&mut wrap.target),
            _ => None,
        }
    }

    /// The caps with a material of their own that it makes, if any.
    pub(super) fn own_cap(&self) -> Option<&OwnCap> {
        match self {
            Self::Cut { cap, fill: true, .. } | Self::Fill { cap, .. } => cap.as_ref(),
            _ => None,
        }
    }

    /// The plane of a cut of which one side stays, and whether that is the one above it.
    pub(super) fn one_sided_plane(&self) -> Option<(CutPlane, bool)> {
        let Self::Cut {
            along: CutLine::Plane(plane),
            keep: side @ (KeptSide::Above | KeptSide::Below),
            ..
        } = self
        else {
            return None;
        };
        let (normal, point) = plane.unit_normal_and_point();
        let offset = normal.dot(point);
        Some((CutPlane { normal, offset }, *side == KeptSide::Above))
    }

    /// Returns the kind of the edit.
    pub fn kind(&self) -> EditKind {
        match self {
            Self::Cut { .. } => EditKind::Cut,
            Self::Subdivide { .. } | Self::SubdivideForPose { .. } => EditKind::Subdivide,
            Self::Decimate { .. } => EditKind::Decimate,
            Self::Delete { .. } => EditKind::Delete,
            Self::Fill { .. } => EditKind::Fill,
            Self::Remesh(_) => EditKind::Remesh,
            Self::Smooth(_) => EditKind::Smooth,
            Self::Merge(_) => EditKind::Merge,
            Self::Wrap(_) => EditKind::Wrap,
            Self::Unintersect(_) => EditKind::Unintersect,
            Self::InsertCurve { .. } => EditKind::InsertCurve,
            Self::Weld { .. } => EditKind::Weld,
            Self::Clean(_) => EditKind::Clean,
            Self::Adopt { .. } => EditKind::Adopt,
        }
    }
}

/// The runs of render vertices that an edit left of `old` ones.
pub(super) fn kept_vertex_runs(applied: &PatchedSurface, old: usize) -> Vec<KeptVertexRun> {
    let mut runs: Vec<KeptVertexRun> = Vec::new();
    for (was, &now) in (0u32..).zip(&applied.vertex_from_old[..old]) {
        if now == NONE {
            continue;
        }
        match runs.last_mut() {
            Some(run) if run.was + run.count == was && run.now + run.count == now => run.count += 1,
            _ => runs.push(KeptVertexRun { was, now, count: 1 }),
        }
    }
    runs
}
