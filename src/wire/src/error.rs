//! What can be wrong with a request.

use super::edit_kind::edit_kind_name;
use pliant_core::engine::{self, InputPlace, RegionPlace};
use pliant_edit::{EditSubject, Error as Refused, ErrorPlace, shown_count};

/// Why a request was refused or could not be carried out. Nothing has changed when one of these is returned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The model cannot be read or written.
    #[error(transparent)]
    Asset(#[from] pliant_asset::Error),
    /// A clip cannot be read.
    #[error("clip: {0}")]
    Clip(#[from] pliant_motion::Error),
    /// A text is not the JSON of the message that was expected.
    #[error("{place}: {problem}")]
    Json {
        /// Path of the field, such as `handles[1].region`, or a line and column.
        place: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// A field has a value that is not allowed.
    #[error("{field}: {problem}")]
    Invalid {
        /// Path of the field in JSON names, such as `handles[1].pose.scale`.
        field: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// The request does not fit the session's present state.
    #[error("{0}")]
    Precondition(String),
    /// Part of the contract that this server does not do.
    #[error("{0} is not implemented by this version")]
    Unimplemented(String),
    /// More than the limits allow.
    #[error("{what} is {}, at most {limit} is allowed", shown_count(*seen))]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// The size seen.
        seen: u64,
        /// The size allowed.
        limit: u64,
    },
    /// The caller gave up.
    #[error("cancelled")]
    Cancelled,
    /// A defect of the server.
    #[error("internal: {0}")]
    Internal(String),
}

impl Error {
    /// A field has a value that is not allowed.
    pub fn invalid(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Invalid {
            field: field.into(),
            problem: problem.into(),
        }
    }
}

impl From<pliant_exec::progress::Cancelled> for Error {
    fn from(_: pliant_exec::progress::Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<engine::Error> for Error {
    fn from(e: engine::Error) -> Self {
        use engine::Error as Engine;
        match e {
            Engine::Asset(e) => Self::Asset(e),
            Engine::Invalid { place, problem } => Self::invalid(field_of_input(place), problem),
            Engine::Clip(e) => Self::Clip(e),
            Engine::Rig(e) => e.into(),
            Engine::SkinWeights { what, problem } => Self::invalid(what, problem),
            Engine::NoSuchFrames { first, frames } => Self::invalid(
                "first",
                format!("is {first}, the animation has {frames} frames, counted from 0"),
            ),
            Engine::Precondition(text) => Self::Precondition(text),
            Engine::Edit(Refused::Invalid { subject, problem }) => Self::invalid(field_of_edit(subject), problem),
            Engine::Edit(Refused::Impossible {
                problem,
                place: ErrorPlace::Argument(subject),
            }) => Self::Precondition(format!("{problem} ({})", field_of_edit(subject))),
            Engine::Edit(refused) => Self::Precondition(refused.to_string()),
            Engine::Unimplemented(what) => Self::Unimplemented(what),
            Engine::TooLarge { what, seen, limit } => Self::TooLarge { what, seen, limit },
            Engine::Cancelled => Self::Cancelled,
            Engine::Internal(text) => Self::Internal(text),
        }
    }
}

/// The field of a request that a value of the engine's input comes from.
fn field_of_input(place: InputPlace) -> String {
    match place {
        InputPlace::HandleRegion(k, part) => format!("handles[{k}].region{}", field_in_region(part)),
        InputPlace::HandleFalloff(k) => format!("handles[{k}].falloff"),
        InputPlace::RegionOfInterest(part) => format!("regionOfInterest{}", field_in_region(part)),
        InputPlace::PosedHandle(k) => format!("pose.handles[{k}].id"),
        InputPlace::EditRegion(kind, part) => format!("{}.region{}", edit_kind_name(kind), field_in_region(part)),
        InputPlace::CutPathVertex(k) => format!("cut.path[{k}]"),
        InputPlace::MergedModel => "merge.model".into(),
        InputPlace::MergedSession => "merge.session".into(),
        InputPlace::MergePlacement => "merge.transform".into(),
        InputPlace::VolumeGraph => "volumeGraph".into(),
        InputPlace::VolumeGraphMode => "volumeGraph.mode".into(),
        InputPlace::Passenger(k) => format!("passengers[{k}]"),
        InputPlace::RigidChain(k) => format!("rigidChains[{k}]"),
        InputPlace::KeptPrimitive(k) => format!("keepApart.primitives[{k}]"),
        InputPlace::KeptComponent(k) => format!("keepApart.components[{k}]"),
    }
}

fn field_in_region(part: RegionPlace) -> String {
    match part {
        RegionPlace::Whole => String::new(),
        RegionPlace::ListedVertex(k) => format!(".vertices.indices[{k}]"),
        RegionPlace::VertexRange(k) => format!(".vertices.ranges[{k}]"),
        RegionPlace::Component => ".component.index".into(),
        RegionPlace::Primitive => ".primitive.index".into(),
        RegionPlace::Weights => ".weights.values".into(),
        RegionPlace::Weight(k) => format!(".weights.values[{k}]"),
    }
}

/// The field of a request that an argument of an operation comes from.
fn field_of_edit(subject: EditSubject) -> String {
    let field = match subject {
        EditSubject::CutPlane => "cut.plane",
        EditSubject::CutCurve => "cut.polyline",
        EditSubject::CutPath => "cut.path",
        EditSubject::InsertedCurve => "insertCurve.points",
        EditSubject::DecimationRatio => "decimate.ratio",
        EditSubject::RemeshEdgeLength => "remesh.edgeLength",
        EditSubject::RemeshDeviation => "remesh.maxDeviation",
        EditSubject::RemeshSharpAngle => "remesh.sharpDegrees",
        EditSubject::RemeshRestShape => "remesh.auto",
        EditSubject::Region => "region",
        EditSubject::DeletedRegion => "delete.region",
        EditSubject::FilledRegion => "fill.region",
        EditSubject::WeldTolerance => "weld.tolerance",
        EditSubject::BoundaryWeldTolerance => "merge.tolerance",
        EditSubject::Surface | EditSubject::Patch(_) => return subject.to_string(),
    };
    field.to_owned()
}
