//! Why the deformer refuses something, with the place in the caller's input as a typed value.

use super::edit_command::EditKind;
use crate::motion::rig::RigError;
use crate::motion::skin_weights::SkinWeightError;
use crate::progress::Cancelled;
use crate::{asset, edit, motion};
use std::fmt;

/// Why something was refused or could not be carried out. Nothing has changed when one of these is returned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The model cannot be read or written.
    #[error(transparent)]
    Asset(asset::Error),
    /// A value of the input does not fit the model.
    #[error("{place}: {problem}")]
    Invalid {
        /// Which value it is.
        place: InputPlace,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// A clip cannot be read.
    #[error("clip: {0}")]
    Clip(#[from] motion::Error),
    /// A rig or a clip does not fit the model, or one does not fit the other.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// Weights of a skin cannot be made of what is given.
    #[error("{what}: {problem}")]
    SkinWeights {
        /// What of it.
        what: String,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// An animation has none of the frames that are asked for.
    #[error("first: is {first}, the animation has {frames} frames, counted from 0")]
    NoSuchFrames {
        /// The first that is asked for.
        first: usize,
        /// How many the animation has.
        frames: usize,
    },
    /// The request does not fit the present state of the deformer.
    #[error("{0}")]
    Precondition(String),
    /// The model's surface does not allow the edit.
    #[error(transparent)]
    Edit(edit::Error),
    /// This version does not do what was asked for.
    #[error("{0} is not implemented by this version")]
    Unimplemented(String),
    /// Something is larger than the limits allow.
    #[error("{what} is {}, at most {limit} is allowed", edit::shown_count(*seen))]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// The size seen.
        seen: u64,
        /// The size allowed.
        limit: u64,
    },
    /// The caller cancelled the work.
    #[error("cancelled")]
    Cancelled,
    /// The deformer has a defect.
    #[error("internal: {0}")]
    Internal(String),
}

/// A value of the input that an error is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InputPlace {
    /// The region of the handle with this index.
    HandleRegion(usize, RegionPlace),
    /// The falloff of the handle with this index.
    HandleFalloff(usize),
    /// The region of interest of a set of handles.
    RegionOfInterest(RegionPlace),
    /// The id in the entry with this index of a change of poses.
    PosedHandle(usize),
    /// The region of an edit.
    EditRegion(EditKind, RegionPlace),
    /// The vertex with this index in the path of a cut.
    CutPathVertex(usize),
    /// The model that a merge adds.
    MergedModel,
    /// The session that a merge adds the model of.
    MergedSession,
    /// The placement of the model that a merge adds.
    MergePlacement,
    /// The choices about the volume graph.
    VolumeGraph,
    /// Whether a volume graph is built.
    VolumeGraphMode,
    /// The passenger with this index.
    Passenger(usize),
    /// The joint with this index in the list of those below which bones are rigid.
    RigidChain(usize),
    /// The primitive with this index in the list of those that are kept apart.
    KeptPrimitive(usize),
    /// The connected part with this index in the list of those that are kept apart.
    KeptComponent(usize),
}

/// A part of a region that an error is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RegionPlace {
    /// The region as a whole.
    Whole,
    /// The listed vertex with this index.
    ListedVertex(usize),
    /// The range of vertices with this index.
    VertexRange(usize),
    /// The number of a connected component.
    Component,
    /// The number of a primitive.
    Primitive,
    /// The list of weights.
    Weights,
    /// The weight with this index.
    Weight(usize),
}

impl Error {
    /// Makes the error that a value of the input does not fit the model.
    pub fn invalid(place: InputPlace, problem: impl Into<String>) -> Self {
        let problem = problem.into();
        Self::Invalid { place, problem }
    }
}

impl From<crate::progress::Cancelled> for Error {
    fn from(_: crate::progress::Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<edit::Error> for Error {
    fn from(e: edit::Error) -> Self {
        match e {
            edit::Error::TooLarge { what, seen, limit } => Self::TooLarge { what, seen, limit },
            edit::Error::Cancelled => Self::Cancelled,
            refused => Self::Edit(refused),
        }
    }
}

impl From<crate::deform::Error> for Error {
    fn from(e: crate::deform::Error) -> Self {
        use crate::deform::Error as Deform;
        match e {
            Deform::Cancelled => Self::Cancelled,
            Deform::Graph(_) => Self::invalid(InputPlace::VolumeGraph, e.to_string()),
            Deform::NoInside => Self::invalid(InputPlace::VolumeGraphMode, e.to_string()),
            Deform::NoPosition | Deform::FreePart { .. } => Self::Precondition(e.to_string()),
            Deform::Unsupported(what) => Self::Unimplemented(what),
            Deform::Solver(_) => Self::Internal(e.to_string()),
        }
    }
}

impl From<SkinWeightError> for Error {
    fn from(e: SkinWeightError) -> Self {
        match e {
            SkinWeightError::Invalid { what, problem } => Self::SkinWeights { what, problem },
            SkinWeightError::Cancelled(_) => Self::Cancelled,
            SkinWeightError::Solver(e) => Self::Internal(e.to_string()),
        }
    }
}

impl fmt::Display for InputPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::HandleRegion(k, part) => write!(f, "handle {k}, {part}"),
            Self::HandleFalloff(k) => write!(f, "handle {k}, falloff"),
            Self::RegionOfInterest(part) => write!(f, "region of interest, {part}"),
            Self::PosedHandle(k) => write!(f, "pose {k}"),
            Self::EditRegion(_, part) => write!(f, "edit, {part}"),
            Self::CutPathVertex(k) => write!(f, "cut, path vertex {k}"),
            Self::MergedModel | Self::MergedSession => f.write_str("merged model"),
            Self::MergePlacement => f.write_str("placement of the merged model"),
            Self::VolumeGraph => f.write_str("volume graph"),
            Self::VolumeGraphMode => f.write_str("mode of the volume graph"),
            Self::Passenger(k) => write!(f, "passenger {k}"),
            Self::RigidChain(k) => write!(f, "rigid chain {k}"),
            Self::KeptPrimitive(k) => write!(f, "primitive {k} to be kept apart"),
            Self::KeptComponent(k) => write!(f, "part {k} to be kept apart"),
        }
    }
}

impl fmt::Display for RegionPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole => f.write_str("region"),
            Self::ListedVertex(k) => write!(f, "listed vertex {k}"),
            Self::VertexRange(k) => write!(f, "vertex range {k}"),
            Self::Component => f.write_str("component"),
            Self::Primitive => f.write_str("primitive"),
            Self::Weights => f.write_str("weights"),
            Self::Weight(k) => write!(f, "weight {k}"),
        }
    }
}

impl From<asset::Error> for Error {
    fn from(error: asset::Error) -> Self {
        match error {
            asset::Error::Cancelled => Self::Cancelled,
            error => Self::Asset(error),
        }
    }
}

/// Why a region cannot be taken.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RegionError {
    /// It does not fit the model.
    Invalid {
        /// The part of it that does not.
        part: RegionPlace,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// The caller cancelled the work.
    Cancelled,
}

impl From<Cancelled> for RegionError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl RegionError {
    pub fn new(part: RegionPlace, problem: String) -> Self {
        Self::Invalid { part, problem }
    }

    /// Says which region of the input it is.
    pub fn with_place(self, place: impl Fn(RegionPlace) -> InputPlace) -> Error {
        match self {
            Self::Invalid { part, problem } => Error::invalid(place(part), problem),
            Self::Cancelled => Error::Cancelled,
        }
    }
}
