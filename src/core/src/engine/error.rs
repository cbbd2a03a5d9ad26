//! Why the deformer refuses something, with the field of the request that it is about.

use crate::motion::rig::RigError;
use crate::motion::skin_weights::SkinWeightError;
use crate::progress::Cancelled;
use crate::{asset, deform, mesh, motion};

/// What is too large where a deformer would hold more bytes than it may.
pub const ESTIMATED_MEMORY: &str = "the estimated memory of the session in bytes";

/// Why something was refused or could not be carried out. Nothing has changed when one of these is returned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The model cannot be read or written.
    #[error(transparent)]
    Asset(asset::Error),
    /// A clip cannot be read.
    #[error("clip: {0}")]
    Clip(#[from] motion::Error),
    /// A text is not the message that was expected.
    #[error("{field}: {problem}")]
    Malformed {
        /// Path of the field, such as `handles[1].region`, or a line and column.
        field: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// A field has a value that is not allowed, or that does not fit the model.
    #[error("{field}: {problem}")]
    Invalid {
        /// Path of the field in JSON names, such as `handles[1].pose.scale`.
        field: String,
        /// What was seen and what is allowed.
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
    /// The request does not fit the present state, or the model's surface does not allow the edit.
    #[error("{0}")]
    Precondition(String),
    /// This version does not do what was asked for.
    #[error("{0} is not implemented by this version")]
    Unimplemented(String),
    /// Something is larger than the limits allow.
    #[error("{what} is {}, at most {limit} is allowed", mesh::shown_count(*seen))]
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
    /// The program has a defect.
    #[error("internal: {0}")]
    Internal(String),
}

impl Error {
    /// Makes the error that a field has a value that is not allowed.
    pub fn invalid(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Invalid {
            field: field.into(),
            problem: problem.into(),
        }
    }

    /// Says which field it is that has the invalid one in it: `below` stands before the path so far.
    pub(super) fn below(self, below: &str) -> Self {
        match self {
            Self::Invalid { field, problem } => Self::invalid(format!("{below}{field}"), problem),
            other => other,
        }
    }
}

impl From<Cancelled> for Error {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
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

/// Errors of operations on the surface.
impl From<mesh::Error> for Error {
    fn from(e: mesh::Error) -> Self {
        match e {
            mesh::Error::Invalid { field, problem } => Self::Invalid { field, problem },
            mesh::Error::TooLarge { what, seen, limit } => Self::TooLarge { what, seen, limit },
            mesh::Error::Cancelled => Self::Cancelled,
            refused => Self::Precondition(refused.to_string()),
        }
    }
}

impl From<deform::Error> for Error {
    fn from(e: deform::Error) -> Self {
        use deform::Error as Deform;
        match e {
            Deform::Cancelled => Self::Cancelled,
            Deform::Graph(_) => Self::invalid("volumeGraph", e.to_string()),
            Deform::NoInside => Self::invalid("volumeGraph.mode", e.to_string()),
            Deform::NoPosition | Deform::FreePart { .. } => Self::Precondition(e.to_string()),
            Deform::Unsupported(what) => Self::Unimplemented(what),
            Deform::Solver(_) => Self::Internal(e.to_string()),
            // How much there is room for, only the caller knows.
            Deform::TooLarge { bytes } => Self::TooLarge {
                what: ESTIMATED_MEMORY,
                seen: bytes,
                limit: 0,
            },
        }
    }
}

impl From<RigError> for Error {
    fn from(e: RigError) -> Self {
        match e {
            RigError::Bone { bone, field, problem } => Self::invalid(format!("bones[{bone}].{field}"), problem),
            RigError::Field { field, problem } => Self::invalid(field, problem),
        }
    }
}

impl From<SkinWeightError> for Error {
    fn from(e: SkinWeightError) -> Self {
        match e {
            SkinWeightError::Invalid { what, problem } => Self::invalid(what, problem),
            SkinWeightError::Cancelled(_) => Self::Cancelled,
            SkinWeightError::Solver(e) => Self::Internal(e.to_string()),
        }
    }
}
