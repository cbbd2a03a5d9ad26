//! How a model is opened and how its poses are solved.

use super::passenger::Passenger;
use crate::asset::{Following, Format};
use crate::deform::{BodyOptions, CoarseOperators, FirstPass, FitOrder, FreePartPolicy, TieOptions, VolumeMode};
use crate::graph::VolumeOptions;
use crate::mesh::Weld;

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
    /// What else of the model's file follows its shape.
    pub following: Following,
}

/// Parts of a model that are not tied to others.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KeptApart {
    /// Indices of primitives: parts with vertices of any of them.
    pub primitives: Vec<u32>,
    /// Indices of connected parts of the mesh.
    pub components: Vec<u32>,
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
            },
            passengers: Vec::new(),
            following: Following::default(),
            kept_apart: KeptApart::default(),
        }
    }
}

/// How a pose is solved.
///
/// ```
/// use pliant_core::engine::SolveSettings;
/// let settings = SolveSettings { tolerance: Some(1e-6), ..Default::default() };
/// assert_eq!(settings.refine, None);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SolveSettings {
    /// Relative residual to reach, when asked for.
    pub tolerance: Option<f64>,
    /// Largest missing displacement as a fraction of the diagonal, when asked for.
    pub max_error: Option<f64>,
    /// How often rotations are fitted after the second pass; `None`: [`COMMIT_REFINE`] times on commit, not at all in a drag.
    pub refine: Option<u32>,
    /// Where fits of a commit begin.
    pub fit_order: FitOrder,
    /// What the neighbours weigh in such a fit.
    pub rotation_smoothing: f64,
    /// How rotations are spread from the handles.
    pub first_pass: FirstPass,
    /// Whether space is deformed by radial basis functions instead of the graph.
    pub spatial_rbf: bool,
}

/// How poses are solved for after an edit where none was solved before it. Records of edits lack it: never change it.
pub(super) const EDITED_AT_REST: SolveSettings = SolveSettings {
    tolerance: Some(1e-4),
    max_error: None,
    refine: None,
    fit_order: FitOrder::GraphAlone,
    rotation_smoothing: 0.0,
    first_pass: FirstPass::Harmonic,
    spatial_rbf: false,
};

impl Default for SolveSettings {
    fn default() -> Self {
        Self {
            tolerance: Some(1e-4),
            max_error: None,
            refine: None,
            fit_order: FitOrder::CoarseFirst,
            rotation_smoothing: 0.0,
            first_pass: FirstPass::Harmonic,
            spatial_rbf: false,
        }
    }
}

/// How a solve treats what was solved before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolveMode {
    /// Starts from the last result, for the sake of speed.
    Drag,
    /// Depends on model, handles, poses and settings alone, so that repeated results are bit-identical.
    Commit,
}
