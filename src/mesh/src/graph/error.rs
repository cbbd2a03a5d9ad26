//! Why a graph cannot be built.

use crate::query::QueryStop;
use pliant_exec::progress::Cancelled;

/// Why a volume graph cannot be built as asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A length among the options is not a positive number.
    #[error("{option} is {seen}, it must be a positive finite length")]
    Length {
        /// The option's name.
        option: &'static str,
        /// The value given.
        seen: f64,
    },
    /// The lattice knows two valences.
    #[error("valence is {seen}, allowed are 14 and 8")]
    Valence {
        /// The value given.
        seen: u32,
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
    /// The work was given up.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<QueryStop> for Error {
    fn from(stop: QueryStop) -> Self {
        match stop {
            QueryStop::Cancelled => Self::Cancelled(Cancelled),
            QueryStop::TooMany { limit } => Self::FacesTooLong { limit },
        }
    }
}
