//! What a commit leaves a session in, and how its shape can be made again.

use crate::engine::{HandlePoses, HandleSet, ModelShape, SolveSettings, TopologyState};
use crate::wire::pb;
use std::sync::Arc;

/// This number names a shape of one session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::session) struct RecordedShapeId(pub u64);

/// This number names a set of handles of one session; two commits with one number have the same handles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::session) struct HandleSetId(pub u64);

/// The handles that a commit has set, with their number.
#[derive(Debug)]
pub(in crate::session) struct CommittedHandles {
    pub id: HandleSetId,
    pub set: HandleSet,
}

/// The state that a commit leaves the session in.
#[derive(Debug, Clone)]
pub(in crate::session) struct SessionState {
    /// What edits have made of the model.
    pub topology: Option<TopologyState>,
    /// Length of its bounding box's diagonal.
    pub diagonal: f64,
    /// The handles in force.
    pub handles: Arc<CommittedHandles>,
    /// Their poses.
    pub poses: HandlePoses,
    /// What was noticed of these.
    pub pose_warnings: Arc<Vec<pb::Warning>>,
    /// What the engine says about model, solver and handles.
    pub facts: Arc<pb::Session>,
    /// The shape.
    pub shape: RecordedShapeId,
    /// Digest of its positions.
    pub digest: String,
}

impl SessionState {
    /// Triangles of the model.
    pub fn triangles(&self) -> u32 {
        self.facts.model.as_ref().map_or(0, |m| m.triangles)
    }

    /// About how many points are looked at when `handles` are set in this state.
    pub fn cost_of_handles(&self, handles: &HandleSet) -> u64 {
        let nodes = self.facts.solver.as_ref().map_or(0, |s| s.graph_vertices);
        let vertices = self.facts.model.as_ref().map_or(0, |m| m.vertices);
        handles.cost(u64::from(nodes) + u64::from(vertices))
    }
}

/// A pose that was solved, to be committed.
#[derive(Debug, Clone)]
pub(in crate::session) struct PosedState {
    pub poses: HandlePoses,
    /// What a user should know of them.
    pub warnings: Vec<pb::Warning>,
    /// How they were solved.
    pub settings: SolveSettings,
    /// `None` where it is not at hand: it is solved again when it is asked for.
    pub shape: Option<ModelShape>,
    /// Digest of its positions.
    pub digest: String,
}

/// The state of an engine that an edit has changed, to be committed.
#[derive(Debug)]
pub(in crate::session) struct EditedState {
    pub topology: Option<TopologyState>,
    pub diagonal: f64,
    pub handles: HandleSet,
    pub poses: HandlePoses,
    pub facts: Box<pb::Session>,
    pub digest: String,
    /// How the shape was solved; `None` when it is the rest shape.
    pub solved_with: Option<SolveSettings>,
}

/// How to make a shape again.
#[derive(Debug, Clone)]
pub(in crate::session) enum ShapeRecipe {
    /// It is the rest shape.
    Rest { topology: Option<TopologyState> },
    /// It is the solution of these poses.
    Solved {
        topology: Option<TopologyState>,
        handles: Arc<CommittedHandles>,
        poses: HandlePoses,
        settings: SolveSettings,
    },
}
