//! Why geometry is rejected, or an operation on it is not done.

use crate::query::QueryStop;
use pliant_exec::progress::Cancelled;

/// Why a mesh or a graph is not made of what is given, or a surface not edited. Nothing has changed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A value is not allowed.
    #[error("{field}: {problem}")]
    Invalid {
        /// Path of the value: an argument, such as `triangles[3]`, or a field of an edit request, such as `cut.plane`.
        field: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// The values are allowed, but not on this surface: the plane misses, loops do not match.
    #[error("{problem} ({place})")]
    Impossible {
        /// What stands against it, and a hint.
        problem: String,
        /// Points, faces or coordinates of the surface, or the path of a value.
        place: String,
    },
    /// More than a limit allows.
    #[error("{what} is {}, at most {limit} is allowed", shown_count(*seen))]
    TooLarge {
        /// Of what.
        what: &'static str,
        /// How many; `u64::MAX`: more than can be counted.
        seen: u64,
        /// How many are allowed.
        limit: u64,
    },
    /// No triangle is left to solve on.
    #[error("none of {triangles} triangles has three distinct corners; a smaller weld tolerance may keep some")]
    NoTriangle {
        /// How many triangles were given.
        triangles: usize,
    },
    /// The mesh and its shell alone are more than allowed; a wider lattice would not help.
    #[error("the graph needs at least {nodes} nodes, at most {limit} are allowed; a surface graph needs {surface}")]
    TooManyNodes {
        /// Nodes of surface and shell.
        nodes: usize,
        /// The limit given.
        limit: usize,
        /// Nodes of the surface alone.
        surface: usize,
    },
    /// More edges than 32-bit offsets can count.
    #[error("the graph may have {edges} edges, at most {limit} can be numbered; a wider interval has fewer")]
    TooManyEdges {
        /// Most edges that it may have.
        edges: usize,
        /// How many can be numbered.
        limit: usize,
    },
    /// Finding interior nodes compares too many faces: the interval is narrow, or faces are as long as the mesh or lie on top of
    /// each other.
    #[error(
        "finding interior nodes takes more than {limit} comparisons, because the interval is too narrow, or because faces are as \
         long as the model or lie on top of each other; set a wider interval, or remesh the model to give it faces of about one size"
    )]
    FacesTooLong {
        /// How many comparisons are allowed.
        limit: u64,
    },
    /// The caller cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// Counts above this are shown as more than this.
const COUNTED: u64 = 1_000_000_000_000;

/// A count as people read it, without digits that are of no use.
pub fn shown_count(seen: u64) -> String {
    match seen {
        COUNTED.. => format!("more than {COUNTED}"),
        seen => seen.to_string(),
    }
}

impl Error {
    /// Makes the error that a value is not allowed.
    pub fn invalid(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Invalid {
            field: field.into(),
            problem: problem.into(),
        }
    }

    /// Makes the error that the surface does not allow an operation, at a place of it.
    pub fn impossible(problem: impl Into<String>, place: impl Into<String>) -> Self {
        Self::Impossible {
            problem: problem.into(),
            place: place.into(),
        }
    }

    /// Refuses a length that is not a positive number.
    pub(crate) fn check_length(field: &str, length: Option<f64>) -> Result<(), Self> {
        match length.filter(|l| !(*l > 0.0 && l.is_finite())) {
            Some(seen) => Err(Self::invalid(
                field,
                format!("is {seen}, it must be a positive finite length"),
            )),
            None => Ok(()),
        }
    }
}

impl From<Cancelled> for Error {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<QueryStop> for Error {
    fn from(stop: QueryStop) -> Self {
        match stop {
            QueryStop::Cancelled => Self::Cancelled,
            QueryStop::TooMany { limit } => Self::FacesTooLong { limit },
        }
    }
}
