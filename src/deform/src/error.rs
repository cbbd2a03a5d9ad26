//! Why a deformation cannot be prepared or solved.

use pliant_exec::progress::Cancelled;

/// Why a deformation cannot be prepared or solved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The graph cannot be built.
    #[error("volume graph: {0}")]
    Graph(String),
    /// A volume graph was required, but the model has no inside.
    #[error("the model encloses no volume, so no volume graph can be built; close its holes or use mode AUTO")]
    NoInside,
    /// No handle holds a position anywhere.
    #[error("no handle constrains POSITION, so nothing says where the model is")]
    NoPosition,
    /// A part has no handle and the policy is to refuse.
    #[error("part {part} (around {place}) has no handle that constrains POSITION; add one, or use FOLLOW or HOLD")]
    FreePart {
        /// Number of the part, by smallest vertex.
        part: usize,
        /// A point of it, model space.
        place: String,
    },
    /// The solver failed.
    #[error("solver: {0}")]
    Solver(String),
    /// The fields of the handles need more memory than there is.
    #[error("the fields of the handles need {bytes} bytes or more, more than there is room for; use fewer handles")]
    TooLarge {
        /// Bytes beside the body and its handles.
        bytes: u64,
    },
    /// A choice that this version does not have.
    #[error("{0}")]
    Unsupported(String),
    /// The caller cancelled the work.
    #[error("cancelled")]
    Cancelled,
}

impl From<Cancelled> for Error {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<pliant_solver::Error> for Error {
    fn from(e: pliant_solver::Error) -> Self {
        match e {
            pliant_solver::Error::Cancelled => Self::Cancelled,
            pliant_solver::Error::Unsupported(what) => Self::Unsupported(what.to_string()),
            other => Self::Solver(other.to_string()),
        }
    }
}

impl From<pliant_mesh::Error> for Error {
    fn from(e: pliant_mesh::Error) -> Self {
        match e {
            pliant_mesh::Error::Cancelled => Self::Cancelled,
            other => Self::Graph(other.to_string()),
        }
    }
}
