//! The ordered commits of a session: what makes undo, redo and replay possible.
//!
//! A session's state is a pure function of its model and the commits up to the current one. Shapes are kept as snapshots while
//! they fit a budget of bytes; an older one is solved again from its recipe, which gives the same bits. Knows no
//! engine and no task: it is told what was solved.

use crate::engine::{DeformerFacts, DeformerWarning, HandlePoses, HandleSet, ModelShape, SolveSettings, TopologyState};
use crate::session::answers::{CommitFacts, HistoryFacts};
use crate::session::history::session_state::{
    CommittedHandles, EditedState, HandleSetId, RecordedShapeId, SessionState, ShapeRecipe,
};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Bytes of handles and poses that one session's commits may hold; the oldest are folded before there are more.
const LOG_BYTES: u64 = 64 << 20;

/// A commit that can be gone back to, with the state that it left.
#[derive(Debug, Clone)]
struct CommitRecord {
    revision: u64,
    kind: &'static str,
    state: SessionState,
}

#[derive(Debug)]
struct RecordedShape {
    recipe: ShapeRecipe,
    snapshot: Option<ModelShape>,
}

/// The commits of one session. Never empty: the first is the session's creation, or what older commits were folded into.
#[derive(Debug)]
pub(in crate::session) struct CommitHistory {
    records: VecDeque<CommitRecord>,
    at: usize,
    revision: u64,
    shapes: BTreeMap<RecordedShapeId, RecordedShape>,
    next_shape: u64,
    next_handle_set: u64,
    limit: usize,
    snapshot_bytes: u64,
}

impl CommitHistory {
    /// The history of a session just created, at rest, on an engine in the state `opened`. At most `limit` commits can be
    /// undone.
    pub fn new(opened: EditedState, rest: ModelShape, limit: usize, snapshot_bytes: u64) -> Self {
        let (shape, topology) = (RecordedShapeId(0), opened.topology.clone());
        let state = SessionState {
            topology: opened.topology,
            diagonal: opened.diagonal,
            handles: Arc::new(CommittedHandles {
                id: HandleSetId(0),
                set: opened.handles,
            }),
            poses: opened.poses,
            pose_warnings: Arc::default(),
            facts: Arc::new(opened.facts),
            shape,
            digest: opened.digest,
        };
        let recorded = RecordedShape {
            recipe: ShapeRecipe::Rest { topology },
            snapshot: Some(rest),
        };
        Self {
            records: VecDeque::from([CommitRecord {
                revision: 1,
                kind: "create",
                state,
            }]),
            at: 0,
            revision: 1,
            shapes: BTreeMap::from([(shape, recorded)]),
            next_shape: 1,
            next_handle_set: 1,
            limit,
            snapshot_bytes,
        }
    }

    fn number_handles(&mut self, set: HandleSet) -> Arc<CommittedHandles> {
        let id = HandleSetId(self.next_handle_set);
        self.next_handle_set += 1;
        Arc::new(CommittedHandles { id, set })
    }

    fn record_shape(&mut self, recipe: ShapeRecipe, shape: ModelShape) -> RecordedShapeId {
        let id = RecordedShapeId(self.next_shape);
        self.next_shape += 1;
        let snapshot = Some(shape);
        self.shapes.insert(id, RecordedShape { recipe, snapshot });
        id
    }

    /// Number of the newest change.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The state that the session is in.
    pub fn current(&self) -> &SessionState {
        &self.records[self.at].state
    }

    /// Where undo would lead.
    pub fn undo_target(&self) -> Option<usize> {
        self.at.checked_sub(1)
    }

    /// Where redo would lead.
    pub fn redo_target(&self) -> Option<usize> {
        (self.at + 1 < self.records.len()).then_some(self.at + 1)
    }

    /// The state after commit `index`.
    pub fn state(&self, index: usize) -> Option<&SessionState> {
        self.records.get(index).map(|r| &r.state)
    }

    /// A shape, or how to solve it again.
    pub fn shape(&self, id: RecordedShapeId) -> Result<ModelShape, ShapeRecipe> {
        let snapshot = self.shapes.get(&id).and_then(|s| s.snapshot.as_ref());
        snapshot.cloned().ok_or_else(|| self.recipe(id))
    }

    /// How to make a shape again.
    pub fn recipe(&self, id: RecordedShapeId) -> ShapeRecipe {
        match self.shapes.get(&id) {
            Some(shape) => shape.recipe.clone(),
            None => ShapeRecipe::Rest {
                topology: self.current().topology.clone(),
            },
        }
    }

    /// Records new handles; the shape stays as it is. What was undone is gone.
    pub fn commit_handles(&mut self, handles: HandleSet, poses: HandlePoses, facts: DeformerFacts) {
        let handles = self.number_handles(handles);
        let state = SessionState {
            handles,
            poses,
            pose_warnings: Arc::default(),
            facts: Arc::new(facts),
            ..self.current().clone()
        };
        self.push_commit("handles", state);
    }

    /// Records solved poses, with what was noticed of them. What was undone is gone.
    pub fn commit_pose(
        &mut self,
        (poses, warnings): (HandlePoses, Vec<DeformerWarning>),
        settings: SolveSettings,
        shape: ModelShape,
        digest: String,
    ) {
        let state = self.current().clone();
        let recipe = ShapeRecipe::Solved {
            topology: state.topology.clone(),
            handles: Arc::clone(&state.handles),
            poses: poses.clone(),
            settings,
        };
        let shape = self.record_shape(recipe, shape);
        let state = SessionState {
            poses,
            pose_warnings: Arc::new(warnings),
            shape,
            digest,
            ..state
        };
        self.push_commit("pose", state);
    }

    /// Records an edit: the state that it left, and its shape. What was undone is gone.
    pub fn commit_edit(&mut self, edited: EditedState, shape: ModelShape) {
        let handles = self.number_handles(edited.handles);
        let topology = edited.topology.clone();
        let recipe = match edited.solved_with {
            None => ShapeRecipe::Rest { topology },
            Some(settings) => ShapeRecipe::Solved {
                topology,
                handles: Arc::clone(&handles),
                poses: edited.poses.clone(),
                settings,
            },
        };
        let state = SessionState {
            topology: edited.topology,
            diagonal: edited.diagonal,
            handles,
            poses: edited.poses,
            pose_warnings: Arc::default(),
            facts: Arc::new(edited.facts),
            shape: self.record_shape(recipe, shape),
            digest: edited.digest,
        };
        self.push_commit("edit", state);
    }

    /// Goes to commit `index`, whose shape is given.
    pub fn go_to_commit(&mut self, index: usize, given: ModelShape) {
        self.at = index.min(self.records.len() - 1);
        self.revision += 1;
        if let Some(shape) = self.shapes.get_mut(&self.records[self.at].state.shape) {
            shape.snapshot = Some(given);
        }
        self.fold_oldest();
    }

    fn push_commit(&mut self, kind: &'static str, state: SessionState) {
        self.records.truncate(self.at + 1);
        self.revision += 1;
        self.records.push_back(CommitRecord {
            revision: self.revision,
            kind,
            state,
        });
        self.at += 1;
        self.fold_oldest();
    }

    /// Folds the oldest commits away and drops snapshots until the limits hold.
    fn fold_oldest(&mut self) {
        let too_many = |h: &Self| h.records.len() > h.limit.saturating_add(1);
        let too_large = |h: &Self| h.log_bytes() > LOG_BYTES || h.edit_bytes() > h.snapshot_bytes.max(LOG_BYTES);
        while self.at > 0 && (too_many(self) || (self.at > 1 && too_large(self))) {
            self.records.pop_front();
            self.at -= 1;
        }
        let used: std::collections::BTreeSet<RecordedShapeId> = self.records.iter().map(|r| r.state.shape).collect();
        self.shapes.retain(|id, _| used.contains(id));
        let current = self.current().shape;
        let mut bytes = self.snapshot_bytes_held();
        // Undo goes from new to old, so the oldest snapshots are missed last.
        for (_, shape) in self.shapes.iter_mut().filter(|(id, _)| **id != current) {
            if bytes <= self.snapshot_bytes {
                break;
            }
            let evictable = matches!(shape.recipe, ShapeRecipe::Solved { .. });
            if evictable && let Some(ModelShape { positions, .. }) = shape.snapshot.take() {
                bytes = bytes.saturating_sub(size_of_val(positions.as_slice()) as u64);
            }
        }
    }

    /// Bytes of the snapshots; the rest shape is the engine's.
    fn snapshot_bytes_held(&self) -> u64 {
        let solved = self
            .shapes
            .values()
            .filter(|s| matches!(s.recipe, ShapeRecipe::Solved { .. }));
        solved
            .filter_map(|s| s.snapshot.as_ref())
            .map(|s| size_of_val(s.positions.as_slice()) as u64)
            .sum()
    }

    /// Bytes of what edits have made of the model, beyond what the engine holds itself.
    fn edit_bytes(&self) -> u64 {
        let now = self.current().topology.as_ref();
        let mut last = None;
        let mut bytes = 0;
        for topology in self.records.iter().filter_map(|r| r.state.topology.as_ref()) {
            let is_same = |other: Option<&TopologyState>| other.is_some_and(|t| t.is_same(topology));
            if !is_same(now) && !is_same(last) {
                bytes += topology.byte_size();
            }
            last = Some(topology);
        }
        bytes
    }

    /// Bytes of the handles and poses recorded, about.
    fn log_bytes(&self) -> u64 {
        let mut bytes = 0;
        let mut last = None;
        for SessionState { handles, poses, .. } in self.records.iter().map(|r| &r.state) {
            if last != Some(handles.id) {
                bytes += handles.set.byte_size() as u64;
            }
            last = Some(handles.id);
            bytes += poses.0.len() as u64 * 256;
        }
        bytes
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.snapshot_bytes_held() + self.log_bytes() + self.edit_bytes()
    }

    /// The commits as clients see them.
    pub fn describe(&self) -> HistoryFacts {
        let commit = |r: &CommitRecord| CommitFacts {
            revision: r.revision,
            kind: r.kind,
            digest: r.state.digest.clone(),
        };
        HistoryFacts {
            commits: self.records.iter().map(commit).collect(),
            current: self.records[self.at].revision,
        }
    }
}

#[cfg(test)]
#[path = "commit_history_tests.rs"]
mod tests;
