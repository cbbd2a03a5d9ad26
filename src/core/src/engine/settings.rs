//! How a model is opened and how its poses are solved, what a deformer may hold, and what it carries along.

use super::error::{ESTIMATED_MEMORY, Error};
use super::handle::HandlePoses;
use crate::asset::{self, FileSet, Following, Format};
use crate::deform::{
    self, BodyOptions, CoarseOperators, FitOrder, FreePartPolicy, Quality, SolveStart, TieOptions, VolumeMode,
};
use crate::graph::VolumeOptions;
use crate::mesh::Weld;
use crate::progress::Progress;
use crate::reference::Method;
use glam::{DQuat, DVec3};

/// How often a commit fits rotations unless asked otherwise.
pub const COMMIT_REFINE: u32 = 4;

/// How a deformer is built from its model. The default builds a volume graph wherever the model has an inside, and ties parts
/// that touch.
#[derive(Debug, Clone)]
pub struct OpenOptions {
    /// The format of the model; `None`: detected by its first bytes.
    pub format: Option<Format>,
    /// How render vertices become solver vertices.
    pub weld: Weld,
    /// What happens to connected parts in which no handle lies.
    pub policy: FreePartPolicy,
    /// How graph and hierarchy are built, and whether parts are tied to each other. `kept_apart` lists parts without
    /// ties.
    pub body: BodyOptions,
    /// Parts that get no ties.
    pub kept_apart: KeptApart,
    /// What rides along without being part of what is solved.
    pub passengers: Vec<Passenger>,
    /// Whether vertices in no triangle, those of points and lines among them, ride along as well. Records of the time before
    /// lack it: there the nodes of hard handles took those in their region along, and all others stayed.
    pub loose_vertices_ride: bool,
    /// Whether every cut ends lines beside the surface. Records of the time before lack it: there only one by a plane that keeps one
    /// side did.
    pub every_cut_ends_lines: bool,
    /// Whether what rides along follows one side alone where parts touch that are not joined, as the halves of a cut do. Records of the
    /// time before lack it: there it followed both.
    pub riders_keep_sides: bool,
    /// What else of the model's file follows its shape.
    pub following: Following,
    /// About how many triangles the surface around a model of Gaussian splats has.
    pub cage_triangles: u32,
}

/// Parts of a model that are not tied to others.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KeptApart {
    /// Indices of primitives: parts with vertices of any of them.
    pub primitives: Vec<u32>,
    /// Indices of connected parts of the mesh.
    pub components: Vec<u32>,
}

impl OpenOptions {
    /// Limits under which the models of such a deformer are read.
    pub(super) fn reading_within(&self, limits: &DeformerLimits) -> DeformerLimits {
        let model = asset::Limits {
            points_and_lines: self.loose_vertices_ride,
            cage_triangles: self.cage_triangles,
            ..limits.model
        };
        DeformerLimits { model, ..*limits }
    }
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            format: None,
            weld: Weld::Rounding,
            policy: FreePartPolicy::Follow,
            body: BodyOptions {
                volume: VolumeMode::Auto,
                graph: VolumeOptions::default(),
                operators: CoarseOperators::FiniteVolume,
                apart: false,
                ties: Some(TieOptions::default()),
                near_origin: true,
                local_fields: true,
            },
            passengers: Vec::new(),
            loose_vertices_ride: true,
            every_cut_ends_lines: true,
            riders_keep_sides: true,
            following: Following::default(),
            cage_triangles: asset::Limits::CAGE_TRIANGLES,
            kept_apart: KeptApart::default(),
        }
    }
}

/// How a pose is solved.
///
/// ```
/// use pliant_core::engine::{Quality, SolveSettings};
/// let settings = SolveSettings::from(Quality { tolerance: Some(1e-6), ..Quality::default() });
/// assert_eq!(settings.quality.refine, None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveSettings {
    /// How exactly. Without [`Quality::refine`], rotations are fitted [`COMMIT_REFINE`] times on commit, not at all in a drag.
    pub quality: Quality,
    /// What the pose is deformed by.
    pub method: Method,
    /// Where fits of a commit begin.
    pub fits: FitOrder,
    /// What a commit does with its fits.
    pub recipe: Recipe,
    /// Whether a drag also answers how space around render vertices has turned and stretched. What rides along then goes where it
    /// goes in single precision, and faster. A commit has no use for it.
    pub gradients: bool,
    /// What a commit or a frame of a drag does about surfaces that the pose pushes through each other.
    pub contact: Contact,
}

/// What a commit or a frame of a drag does about surfaces that the pose pushes through each other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Contact {
    /// They cross.
    #[default]
    Ignored,
    /// They are moved apart as far as handles let them, so that fewer triangles cross, or the shape stays as it is.
    Avoided {
        /// In a commit, what surfaces that have crossed keep from each other, model units; less where they were nearer in the rest pose. `None`: 0.1
        /// of the median edge around where they cross.
        clearance: Option<f64>,
    },
}

/// What a commit does with fitted rotations, as it grew: each does what those before it did. A record names the one that its
/// shape was solved by, and is solved by that one again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Recipe {
    /// They are taken as they come.
    AsTheyCome,
    /// A commit that says nothing of fits is kept from having more folds and crossings than without them.
    Unbuckled,
    /// What is free leaves hard handles in their direction.
    #[default]
    SmoothBorders,
}

impl Recipe {
    /// All, oldest first; a record has the place in this list.
    pub const ALL: [Self; 3] = [Self::AsTheyCome, Self::Unbuckled, Self::SmoothBorders];
}

impl Default for SolveSettings {
    fn default() -> Self {
        Self {
            quality: Quality::DEFAULT,
            method: Method::default(),
            fits: FitOrder::default(),
            recipe: Recipe::default(),
            gradients: false,
            contact: Contact::default(),
        }
    }
}

impl SolveSettings {
    /// Whether fits of a commit are looked at: only where nothing was said of them.
    pub(super) fn watches_fits(&self) -> bool {
        let Quality { refine, smoothing, .. } = self.quality;
        self.recipe >= Recipe::Unbuckled && refine.is_none() && smoothing == 0.0 && self.method == Method::Harmonic
    }
}

impl From<Quality> for SolveSettings {
    fn from(quality: Quality) -> Self {
        Self {
            quality,
            ..Self::default()
        }
    }
}

/// How poses are solved for after an edit where none was solved before it. Records of edits lack it: never change it.
pub(super) const EDITED_AT_REST: SolveSettings = SolveSettings {
    quality: Quality {
        tolerance: Some(1e-4),
        max_error: None,
        refine: None,
        smoothing: 0.0,
        keeps_volume: false,
    },
    method: Method::Harmonic,
    fits: FitOrder::GraphAlone,
    recipe: Recipe::AsTheyCome,
    gradients: false,
    contact: Contact::Ignored,
};

/// How a solve treats what was solved before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolveMode {
    /// Starts from the last result, for the sake of speed.
    Drag,
    /// Solved as a commit is, fits from the coarse levels on, but not looked at for folds: for poses of a drag that must not depend on
    /// those before them.
    Anew,
    /// Depends on model, handles, poses and settings alone, so that repeated results are bit-identical.
    Commit,
}

impl SolveMode {
    /// Where a pose starts that goes on from no other pose's shape.
    pub(super) fn start(self) -> SolveStart {
        match self {
            Self::Drag => SolveStart::Warm,
            Self::Anew | Self::Commit => SolveStart::Fresh,
        }
    }
}

/// Poses of all handles, and how they are solved.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseRecipe {
    /// The poses.
    pub poses: HandlePoses,
    /// How they are solved.
    pub settings: SolveSettings,
}

/// A pose with those that it goes on from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseChain {
    /// The poses from whose shapes fits go on in turn, the oldest first; none: they begin from nothing.
    pub starts: Vec<PoseRecipe>,
    /// The pose.
    pub pose: PoseRecipe,
}

impl PoseChain {
    /// Poses that are solved with `settings`, from the last of `starts`.
    pub fn of(starts: Vec<PoseRecipe>, poses: HandlePoses, settings: SolveSettings) -> Self {
        let pose = PoseRecipe { poses, settings };
        Self { starts, pose }
    }
}

/// What a deformer may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeformerLimits {
    /// Sizes of the model.
    pub model: asset::Limits,
    /// Bytes that the deformer may hold; checked by estimate before anything large is allocated.
    pub memory_bytes: u64,
    /// Bytes for volume graphs: a graph that needs more gets a wider lattice, or none. `None`: `memory_bytes`. Shapes
    /// depend on it; they do not depend on `memory_bytes`, which may be the free memory of the moment. To get the same
    /// bits again, open a model with the same number.
    pub graph_bytes: Option<u64>,
    /// Handles of one request.
    pub handles: usize,
}

impl Default for DeformerLimits {
    fn default() -> Self {
        Self {
            model: asset::Limits::default(),
            memory_bytes: 16 << 30,
            graph_bytes: None,
            handles: 16_384,
        }
    }
}

impl DeformerLimits {
    /// The limits of a model that is read: what reading it takes is of the same memory.
    pub(super) fn of_reading(&self) -> asset::Limits {
        asset::Limits {
            decoded_bytes: self.model.decoded_bytes.min(self.memory_bytes),
            document_bytes: self.model.document_bytes.min(self.memory_bytes),
            ..self.model
        }
    }
}

/// Watches work beside which a deformer holds bytes already.
pub(super) struct HeldBeside<'a> {
    /// The bytes that it holds.
    pub held: u64,
    /// The bytes that it may hold, whatever its watcher says.
    pub most: u64,
    /// Who watches the deformer.
    pub watcher: &'a dyn Progress,
}

impl<'a> HeldBeside<'a> {
    /// Beside `held` bytes, as far as the watcher goes.
    pub fn of(held: u64, watcher: &'a dyn Progress) -> Self {
        Self::within(held, u64::MAX, watcher)
    }

    /// Beside `held` bytes, up to `most` in all.
    pub fn within(held: u64, most: u64, watcher: &'a dyn Progress) -> Self {
        Self { held, most, watcher }
    }

    /// Why a deformation could not be prepared, with what it may hold.
    pub fn refusal(&self, error: deform::Error) -> Error {
        match error {
            deform::Error::TooLarge { bytes } => Error::TooLarge {
                what: ESTIMATED_MEMORY,
                seen: self.held.saturating_add(bytes),
                limit: self.most,
            },
            other => other.into(),
        }
    }
}

impl Progress for HeldBeside<'_> {
    fn cancelled(&self) -> bool {
        self.watcher.cancelled()
    }

    fn may_hold(&self, bytes: u64) -> bool {
        let bytes = self.held.saturating_add(bytes);
        bytes <= self.most && self.watcher.may_hold(bytes)
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        self.watcher.report(stage, fraction);
    }

    fn begin_pass(&self, pass: &'static str) {
        self.watcher.begin_pass(pass);
    }
}

/// Something in the rest space of a model that is not solved, but follows the surface and volume around it.
#[derive(Debug, Clone)]
pub struct Passenger {
    /// What reports call it.
    pub name: String,
    /// What it is.
    pub kind: PassengerKind,
}

/// The kinds of passengers. The deformer carries primitives and nodes of the model itself. The caller carries points
/// and other models, with [`crate::engine::Deformer::carry_points`] and [`crate::engine::Deformer::carry_model`].
#[derive(Debug, Clone)]
pub enum PassengerKind {
    /// The primitive with this index.
    Primitive(u32),
    /// All primitives of this name: of a glTF those under the node of this name.
    PrimitivesNamed(String),
    /// The node of the model's file with this index.
    Node(u32),
    /// All nodes of this name.
    NodesNamed(String),
    /// Points with axes.
    Points {
        /// Their rest positions.
        positions: Vec<DVec3>,
        /// The rest rotation of the axes, one for each.
        rotations: Vec<DQuat>,
    },
    /// Another model, or Gaussian splats, that stand in the rest space.
    Model(CarriedModel),
}

/// Another model, or Gaussian splats, that ride along.
#[derive(Debug, Clone)]
pub struct CarriedModel {
    /// Its files.
    pub files: FileSet,
    /// The format that they are in; `None`: detected by their first bytes.
    pub format: Option<Format>,
    /// The format to write it in; `None`: its own.
    pub output: Option<Format>,
    /// Where it is to be written; empty where the caller has no use for a path.
    pub path: String,
}
