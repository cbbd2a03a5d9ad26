//! The messages of the store's records. A field is never taken away and a number never used again: what was written by the
//! first version is read by all.

use crate::pb;

/// How a session's model was opened, and what its files are.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct ModelMessage {
    #[prost(message, optional, tag = "1")]
    pub files: Option<FileReferences>,
    #[prost(message, optional, tag = "2")]
    pub options: Option<pb::CreateOptions>,
    #[prost(string, tag = "3")]
    pub label: String,
    #[prost(string, tag = "4")]
    pub format: String,
    #[prost(uint64, optional, tag = "5")]
    pub graph_bytes: Option<u64>,
    /// See [`RecordedModel`](super::RecordedModel).
    #[prost(bool, tag = "6")]
    pub of_today: bool,
    /// See [`RecordedModel`](super::RecordedModel).
    #[prost(bool, tag = "7")]
    pub loose_vertices_ride: bool,
    /// See [`RecordedModel`](super::RecordedModel).
    #[prost(bool, tag = "8")]
    pub near_origin: bool,
    /// See [`RecordedModel`](super::RecordedModel).
    #[prost(bool, tag = "9")]
    pub every_cut_ends_lines: bool,
    /// See [`RecordedModel`](super::RecordedModel).
    #[prost(bool, tag = "10")]
    pub riders_keep_sides: bool,
    /// See [`RecordedModel`](super::RecordedModel).
    #[prost(bool, tag = "11")]
    pub follows_edits: bool,
    /// See [`RecordedModel`](super::RecordedModel).
    #[prost(bool, tag = "12")]
    pub local_fields: bool,
}

/// Files by the names of the objects that hold them.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct FileReferences {
    /// Name of the main file, as in [`FileSet`](pliant_asset::FileSet).
    #[prost(string, tag = "1")]
    pub name: String,
    /// The object of the main file.
    #[prost(string, tag = "2")]
    pub main: String,
    /// The objects of the companions, by the name of each.
    #[prost(btree_map = "string, string", tag = "3")]
    pub companions: std::collections::BTreeMap<String, String>,
}

/// A commit.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct CommitMessage {
    #[prost(oneof = "CommitKindMessage", tags = "1, 2, 3, 4, 5")]
    pub kind: Option<CommitKindMessage>,
}

/// The kinds of commits.
#[derive(Clone, PartialEq, prost::Oneof)]
// One is written or read at a time; a box would only be in the way.
#[allow(clippy::large_enum_variant)]
pub(super) enum CommitKindMessage {
    #[prost(message, tag = "1")]
    Create(CreationMessage),
    #[prost(message, tag = "2")]
    Handles(HandlesMessage),
    #[prost(message, tag = "3")]
    Pose(PoseMessage),
    #[prost(message, tag = "4")]
    Edit(EditMessage),
    #[prost(message, tag = "5")]
    Step(StepMessage),
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct CreationMessage {
    #[prost(message, optional, tag = "1")]
    pub facts: Option<pb::Session>,
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct HandlesMessage {
    #[prost(message, optional, tag = "1")]
    pub set: Option<pb::SetHandlesRequest>,
    #[prost(message, repeated, tag = "2")]
    pub poses: Vec<pb::HandlePose>,
    #[prost(message, optional, tag = "3")]
    pub facts: Option<pb::Session>,
    /// Absent in records of the time when handles turned about the middle of their regions.
    #[prost(bool, tag = "4")]
    pub about_joints: bool,
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct PoseMessage {
    #[prost(message, repeated, tag = "1")]
    pub poses: Vec<pb::HandlePose>,
    #[prost(message, optional, tag = "2")]
    pub settings: Option<SettingsMessage>,
    #[prost(message, repeated, tag = "3")]
    pub warnings: Vec<pb::Warning>,
    #[prost(message, optional, tag = "4")]
    pub probe: Option<ShapeProbe>,
    #[prost(message, optional, tag = "5")]
    pub frame: Option<FrameMessage>,
    /// Absent in records of the time when they were not returned.
    #[prost(message, repeated, tag = "6")]
    pub found_turns: Vec<pb::FoundTurn>,
    /// What it goes on from, the oldest first.
    #[prost(message, repeated, tag = "7")]
    pub starts: Vec<StartMessage>,
}

/// A pose that another goes on from.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct StartMessage {
    #[prost(message, repeated, tag = "1")]
    pub poses: Vec<pb::HandlePose>,
    #[prost(message, optional, tag = "2")]
    pub settings: Option<SettingsMessage>,
}

/// How a pose was solved. What is absent was not asked for; no default of a request has a part in it.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct SettingsMessage {
    #[prost(double, optional, tag = "1")]
    pub tolerance: Option<f64>,
    #[prost(double, optional, tag = "2")]
    pub max_error: Option<f64>,
    #[prost(uint32, optional, tag = "3")]
    pub refine: Option<u32>,
    #[prost(double, tag = "4")]
    pub rotation_smoothing: f64,
    #[prost(enumeration = "pb::options::FirstPass", tag = "5")]
    pub first_pass: i32,
    #[prost(bool, tag = "6")]
    pub spatial_rbf: bool,
    /// Absent in records of the time when all fits were on the graph alone.
    #[prost(bool, tag = "7")]
    pub coarse_first: bool,
    /// The place in `Recipe::ALL`. It was a bool when there were two.
    #[prost(uint32, tag = "8")]
    pub recipe: u32,
    /// Absent in records of the time when volume was not kept.
    #[prost(bool, tag = "9")]
    pub keeps_volume: bool,
    /// Absent where surfaces may cross, and in records of the time when they always could.
    #[prost(message, optional, tag = "10")]
    pub contact: Option<AvoidedContactMessage>,
}

/// How surfaces were kept from crossing.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(super) struct AvoidedContactMessage {
    #[prost(double, optional, tag = "1")]
    pub clearance: Option<f64>,
}

/// The frame that answered a pose, but for its vertices.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct FrameMessage {
    #[prost(uint64, tag = "1")]
    pub seq: u64,
    #[prost(double, tag = "2")]
    pub residual: f64,
    #[prost(double, tag = "3")]
    pub max_error: f64,
    #[prost(double, tag = "4")]
    pub solve_ms: f64,
    #[prost(double, tag = "5")]
    pub queue_ms: f64,
    #[prost(message, optional, tag = "6")]
    pub quality: Option<pb::Quality>,
    #[prost(message, optional, tag = "7")]
    pub output: Option<pb::Output>,
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct EditMessage {
    #[prost(message, optional, tag = "1")]
    pub request: Option<pb::EditRequest>,
    /// The files of a merge.
    #[prost(message, optional, tag = "2")]
    pub files: Option<FileReferences>,
    /// Whether the other model of a merge was that of a session.
    #[prost(bool, tag = "3")]
    pub from_session: bool,
    #[prost(message, optional, tag = "4")]
    pub report: Option<pb::EditResult>,
    #[prost(message, repeated, tag = "5")]
    pub poses: Vec<pb::HandlePose>,
    #[prost(message, optional, tag = "6")]
    pub facts: Option<pb::Session>,
    #[prost(message, optional, tag = "7")]
    pub probe: Option<ShapeProbe>,
}

/// A few places of a shape: enough to check whether another build or processor, whose results differ in late digits,
/// made the same shape.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ShapeProbe {
    /// Render vertices of the shape.
    #[prost(uint64, tag = "1")]
    pub vertices: u64,
    /// Some of them, evenly chosen: x, y, z of each in a row.
    #[prost(double, repeated, tag = "2")]
    pub places: Vec<f64>,
}

/// Undo or redo: the revision of the commit that it went to.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct StepMessage {
    #[prost(uint64, tag = "1")]
    pub target: u64,
    #[prost(bool, tag = "2")]
    pub forward: bool,
}
