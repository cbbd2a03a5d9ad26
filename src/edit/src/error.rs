//! Why an edit is refused.

use std::fmt;

/// Why an edit cannot be done. The surface is as it was.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A value that the operation does not allow.
    #[error("{subject}: {problem}")]
    Invalid {
        /// Which argument of the operation it is.
        subject: EditSubject,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// The values are allowed, but not on this surface: the plane misses, loops do not match.
    #[error("{problem} ({place})")]
    Impossible {
        /// What stands against it, and a hint.
        problem: String,
        /// Where it stands.
        place: ErrorPlace,
    },
    /// The result would exceed a limit.
    #[error("the result would have {} {what}, the limit is {limit}", shown_count(*seen))]
    TooLarge {
        /// Of what.
        what: &'static str,
        /// How many; `u64::MAX`: more than can be counted.
        seen: u64,
        /// How many are allowed.
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
    /// Makes the error that an argument of an operation has a value which is not allowed.
    pub(super) fn invalid(subject: EditSubject, problem: impl Into<String>) -> Self {
        let problem = problem.into();
        Self::Invalid { subject, problem }
    }

    /// Makes the error that the surface does not allow an operation, at a place given in words or coordinates.
    pub(super) fn impossible(problem: impl Into<String>, place: impl Into<String>) -> Self {
        Self::Impossible {
            problem: problem.into(),
            place: ErrorPlace::Described(place.into()),
        }
    }
}

impl From<pliant_exec::progress::Cancelled> for Error {
    fn from(_: pliant_exec::progress::Cancelled) -> Self {
        Self::Cancelled
    }
}

/// An argument of an operation that an error is about. Callers map it to their own name for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EditSubject {
    /// The plane to cut by.
    CutPlane,
    /// The drawn places of the curve to cut along.
    CutCurve,
    /// The points of the edge path to cut along.
    CutPath,
    /// The points of the curve to insert.
    InsertedCurve,
    /// The part of the triangles that decimation is to leave.
    DecimationRatio,
    /// The edge length to remesh to.
    RemeshEdgeLength,
    /// How far a remesh may go from the old surface.
    RemeshDeviation,
    /// The angle beyond which a remesh keeps edges.
    RemeshSharpAngle,
    /// The rest shape that a remesh takes its lengths from.
    RemeshRestShape,
    /// The triangles to change.
    Region,
    /// The triangles to delete.
    DeletedRegion,
    /// The triangles whose holes are to be filled.
    FilledRegion,
    /// How far apart points to be welded may lie.
    WeldTolerance,
    /// How far apart boundary points of two models to be welded may lie.
    BoundaryWeldTolerance,
    /// The arrays of the surface.
    Surface,
    /// A field of a surface patch, by its name in [`SurfacePatch`](super::SurfacePatch).
    Patch(&'static str),
}

impl fmt::Display for EditSubject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CutPlane => "cutting plane",
            Self::CutCurve => "cutting curve",
            Self::CutPath => "cutting path",
            Self::InsertedCurve => "inserted curve",
            Self::DecimationRatio => "decimation ratio",
            Self::RemeshEdgeLength => "edge length of the remesh",
            Self::RemeshDeviation => "largest deviation of the remesh",
            Self::RemeshSharpAngle => "sharp angle of the remesh",
            Self::RemeshRestShape => "rest shape of the remesh",
            Self::Region => "region",
            Self::DeletedRegion => "deleted region",
            Self::FilledRegion => "filled region",
            Self::WeldTolerance => "weld tolerance",
            Self::BoundaryWeldTolerance => "boundary weld tolerance",
            Self::Surface => "surface",
            Self::Patch(field) => return write!(f, "patch.{field}"),
        })
    }
}

/// Where on the surface, or in which argument, an operation turned out to be impossible.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ErrorPlace {
    /// Points, faces or coordinates, in words.
    Described(String),
    /// An argument of the operation.
    Argument(EditSubject),
}

impl fmt::Display for ErrorPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Described(text) => f.write_str(text),
            Self::Argument(subject) => subject.fmt(f),
        }
    }
}
