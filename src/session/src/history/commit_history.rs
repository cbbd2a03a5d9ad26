//! The ordered commits of a session: what makes undo, redo and replay possible.
//!
//! A session's state is a pure function of its model and the commits up to the current one. Shapes are kept as
//! snapshots while they fit a budget of bytes; an older one is solved again from its recipe, bit for bit. The history
//! has no engine and no task: callers pass it solutions.

use crate::history::session_state::CommitList;
use crate::history::session_state::{
    CommittedHandles, EditedState, HandleSetId, PosedState, RecordedShapeId, SessionState, ShapeRecipe,
};
use pliant_core::engine::{
    Error, HandlePose, HandlePoses, HandleSet, ModelShape, PoseChain, PoseRecipe, TopologyState,
};
use pliant_wire::{add_found_turns, pb};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// Bytes of handles and poses that one session's commits may hold; the oldest are folded before there are more.
const LOG_BYTES: u64 = 64 << 20;

/// Shapes at most that a pose goes on from, each from the one before it: all are solved again for it.
const MOST_STARTS: usize = 16;

/// Bytes of a recorded pose of one handle, about.
const POSE_BYTES: u64 = 256;

/// A commit that can be gone back to, with the state that it left.
#[derive(Debug, Clone)]
struct CommitRecord {
    revision: u64,
    state: SessionState,
    /// Bytes of its poses, and of its handles where the commit before has others.
    log_bytes: u64,
}

#[derive(Debug)]
struct RecordedShape {
    recipe: ShapeRecipe,
    snapshot: Option<ModelShape>,
    /// Commits that have it.
    uses: usize,
}

impl RecordedShape {
    /// Bytes of its snapshot; the rest shape is the engine's.
    fn snapshot_bytes(&self) -> u64 {
        match (&self.recipe, &self.snapshot) {
            (ShapeRecipe::Solved { .. }, Some(shape)) => size_of_val(shape.positions.as_slice()) as u64,
            _ => 0,
        }
    }
}

/// Commits that follow each other and have the same edited model.
#[derive(Debug)]
struct SameTopology {
    topology: TopologyState,
    commits: usize,
}

/// The commits as they are shown.
#[derive(Debug, Clone)]
pub(crate) struct ShownCommits {
    /// The commits, oldest first.
    pub list: CommitList,
    /// Revision of the one that the session is at.
    pub current: u64,
}

/// The commits of one session. Never empty: the first is the session's creation, or what older commits were folded into. What is
/// held is counted as it comes and goes, so a commit costs the same however many there are.
#[derive(Debug)]
pub(crate) struct CommitHistory {
    records: VecDeque<CommitRecord>,
    at: usize,
    revision: u64,
    shown: CommitList,
    shapes: BTreeMap<RecordedShapeId, RecordedShape>,
    /// The shapes whose snapshots count.
    snapshots: BTreeSet<RecordedShapeId>,
    runs: VecDeque<SameTopology>,
    held_snapshot_bytes: u64,
    held_log_bytes: u64,
    next_shape: u64,
    next_handle_set: u64,
    limit: usize,
    snapshot_bytes: u64,
}

impl CommitHistory {
    /// The history of a new session in the rest pose, on an engine in the state `opened`. At most `limit` commits can
    /// be undone.
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
            facts: opened.facts.into(),
            shape,
            digest: opened.digest,
        };
        let recorded = RecordedShape {
            recipe: ShapeRecipe::Rest { topology },
            snapshot: Some(rest),
            uses: 0,
        };
        let mut history = Self {
            records: VecDeque::new(),
            at: 0,
            revision: 1,
            shown: CommitList::default(),
            shapes: BTreeMap::from([(shape, recorded)]),
            snapshots: BTreeSet::new(),
            runs: VecDeque::new(),
            held_snapshot_bytes: 0,
            held_log_bytes: 0,
            next_shape: 1,
            next_handle_set: 1,
            limit,
            snapshot_bytes,
        };
        history.add_record("create", state);
        history
    }

    fn number_handles(&mut self, set: HandleSet) -> Arc<CommittedHandles> {
        let id = HandleSetId(self.next_handle_set);
        self.next_handle_set += 1;
        Arc::new(CommittedHandles { id, set })
    }

    fn record_shape(&mut self, recipe: ShapeRecipe, shape: Option<ModelShape>) -> RecordedShapeId {
        let id = RecordedShapeId(self.next_shape);
        self.next_shape += 1;
        let recorded = RecordedShape {
            recipe,
            snapshot: None,
            uses: 0,
        };
        self.shapes.insert(id, recorded);
        self.set_snapshot(id, shape);
        id
    }

    /// Keeps or drops the snapshot of a shape.
    fn set_snapshot(&mut self, id: RecordedShapeId, snapshot: Option<ModelShape>) {
        let Some(shape) = self.shapes.get_mut(&id) else { return };
        self.held_snapshot_bytes -= shape.snapshot_bytes();
        shape.snapshot = snapshot;
        self.held_snapshot_bytes += shape.snapshot_bytes();
        if shape.snapshot.is_some() && matches!(shape.recipe, ShapeRecipe::Solved { .. }) {
            self.snapshots.insert(id);
        } else {
            self.snapshots.remove(&id);
        }
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
    pub fn commit_handles(&mut self, handles: HandleSet, poses: HandlePoses, facts: Box<pb::Session>) {
        let handles = self.number_handles(handles);
        let state = SessionState {
            handles,
            poses,
            pose_warnings: Arc::default(),
            facts: facts.into(),
            ..self.current().clone()
        };
        self.push_commit("handles", state);
    }

    /// Records solved poses, with what was noticed of them. What was undone is gone. Without the shape, it is solved when it is asked
    /// for.
    pub fn commit_pose(&mut self, posed: PosedState) {
        let PosedState {
            chain,
            warnings,
            found_turns,
            shape,
            digest,
        } = posed;
        let poses = chain.pose.poses.clone();
        let mut state = self.current().clone();
        if !found_turns.is_empty() || state.facts.handles.iter().any(|h| !h.found_turn.is_empty()) {
            add_found_turns(&mut Arc::make_mut(&mut state.facts).handles, &found_turns);
        }
        let recipe = ShapeRecipe::Solved {
            topology: state.topology.clone(),
            handles: Arc::clone(&state.handles),
            chain: Arc::new(chain),
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
                chain: Arc::new(PoseChain::of(Vec::new(), edited.poses.clone(), settings)),
            },
        };
        let state = SessionState {
            topology: edited.topology,
            diagonal: edited.diagonal,
            handles,
            poses: edited.poses,
            pose_warnings: Arc::default(),
            facts: edited.facts.into(),
            shape: self.record_shape(recipe, Some(shape)),
            digest: edited.digest,
        };
        self.push_commit("edit", state);
    }

    /// Goes to commit `index`, whose shape is given. Without it, it is solved when it is asked for.
    pub fn go_to_commit(&mut self, index: usize, given: impl Into<Option<ModelShape>>) {
        self.at = index.min(self.records.len() - 1);
        self.revision += 1;
        if let Some(given) = given.into() {
            self.set_snapshot(self.records[self.at].state.shape, Some(given));
        }
        self.fold_oldest();
    }

    /// Keeps the shape of the current commit, which was solved again.
    pub fn keep_current_shape(&mut self, given: ModelShape) {
        self.set_snapshot(self.current().shape, Some(given));
        self.fold_oldest();
    }

    /// Drops all snapshots but that of the current shape: they can be solved again.
    pub fn drop_snapshots(&mut self) {
        let current = self.current().shape;
        let others: Vec<_> = self.snapshots.iter().copied().filter(|id| *id != current).collect();
        others.into_iter().for_each(|id| self.set_snapshot(id, None));
    }

    /// Records another digest of commit `index` and all that have its shape.
    pub fn record_digest(&mut self, index: usize, digest: &str) {
        let Some(shape) = self.state(index).map(|s| s.shape) else {
            return;
        };
        for (k, record) in self
            .records
            .iter_mut()
            .enumerate()
            .filter(|(_, r)| r.state.shape == shape)
        {
            digest.clone_into(&mut record.state.digest);
            self.shown.set_digest(k, digest);
        }
    }

    /// Sets how many commits can be undone.
    pub fn set_limit(&mut self, limit: usize) {
        self.limit = limit;
        self.fold_oldest();
    }

    /// Whether the current shape is another than the rest shape.
    pub fn is_solved(&self) -> bool {
        matches!(self.recipe(self.current().shape), ShapeRecipe::Solved { .. })
    }

    /// The revision of the commit that the session is at.
    pub fn current_revision(&self) -> u64 {
        self.records[self.at].revision
    }

    /// The revision of commit `index`.
    pub fn revision_of(&self, index: usize) -> Option<u64> {
        self.records.get(index).map(|r| r.revision)
    }

    /// The commit of a revision, if it can be gone to.
    pub fn index_of(&self, revision: u64) -> Option<usize> {
        self.records.iter().position(|r| r.revision == revision)
    }

    /// The revision of the oldest commit that can be gone to.
    pub fn oldest_revision(&self) -> u64 {
        self.records.front().map_or(0, |r| r.revision)
    }

    /// The poses that are solved in turn for a pose of now to go on from the shape of `revision`, the oldest first; none without one.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a revision that cannot be gone to, one of other handles or another model, and one with too many starts.
    pub fn starts_from(&self, revision: Option<u64>) -> Result<Vec<PoseRecipe>, Error> {
        let Some(revision) = revision else {
            return Ok(Vec::new());
        };
        let refused = |problem: String| Error::invalid("options.fromRevision", format!("is {revision}, {problem}"));
        let Some(state) = self.index_of(revision).and_then(|index| self.state(index)) else {
            let newest = self.records.back().map_or(0, |record| record.revision);
            let problem = format!(
                "which cannot be gone to; those of the commits from {} to {newest} can",
                self.oldest_revision()
            );
            return Err(refused(problem));
        };
        let now = self.current();
        let is_same_model = match (&state.topology, &now.topology) {
            (Some(then), Some(now)) => then.is_same(now),
            (then, now) => then.is_none() && now.is_none(),
        };
        let recipe = self.recipe(state.shape);
        let has_handles = |handles: &CommittedHandles| handles.id == now.handles.id;
        let path: Vec<PoseRecipe> = match recipe {
            ShapeRecipe::Rest { .. } if has_handles(&state.handles) && is_same_model => vec![PoseRecipe {
                poses: state.poses.clone(),
                ..PoseRecipe::default()
            }],
            ShapeRecipe::Solved { handles, chain, .. } if has_handles(&handles) && is_same_model => {
                chain.starts.iter().chain([&chain.pose]).cloned().collect()
            }
            _ => {
                let problem = "whose shape was solved with other handles, or of another model; handles and model must be those of now";
                return Err(refused(problem.into()));
            }
        };
        match path.len() {
            0..=MOST_STARTS => Ok(path),
            count => Err(refused(format!(
                "whose shape goes on from {} others in turn; allowed are {}",
                count - 1,
                MOST_STARTS - 1
            ))),
        }
    }

    fn push_commit(&mut self, kind: &'static str, state: SessionState) {
        while self.records.len() > self.at + 1 {
            self.drop_newest();
        }
        self.revision += 1;
        self.add_record(kind, state);
        self.at += 1;
        self.fold_oldest();
    }

    fn add_record(&mut self, kind: &'static str, state: SessionState) {
        let last = self.records.back().map(|r| r.state.handles.id);
        let handles = if last == Some(state.handles.id) {
            0
        } else {
            handle_bytes(&state)
        };
        let starts = match self.shapes.get(&state.shape).map(|shape| &shape.recipe) {
            Some(ShapeRecipe::Solved { chain, .. }) => chain.starts.as_slice(),
            _ => &[],
        };
        let poses = starts.iter().map(|start| &start.poses).chain([&state.poses]);
        let log_bytes = handles + poses.map(pose_bytes).sum::<u64>();
        self.held_log_bytes += log_bytes;
        if let Some(shape) = self.shapes.get_mut(&state.shape) {
            shape.uses += 1;
        }
        if let Some(topology) = &state.topology {
            match self.runs.back_mut().filter(|run| run.topology.is_same(topology)) {
                Some(run) => run.commits += 1,
                None => self.runs.push_back(SameTopology {
                    topology: topology.clone(),
                    commits: 1,
                }),
            }
        }
        self.shown.push(pb::Commit {
            revision: self.revision,
            kind: kind.into(),
            digest: state.digest.clone(),
        });
        self.records.push_back(CommitRecord {
            revision: self.revision,
            state,
            log_bytes,
        });
    }

    fn drop_newest(&mut self) {
        let Some(gone) = self.records.pop_back() else { return };
        self.shown.truncate(self.records.len());
        self.held_log_bytes -= gone.log_bytes;
        if gone.state.topology.is_some()
            && let Some(run) = self.runs.back_mut()
        {
            run.commits -= 1;
            if run.commits == 0 {
                self.runs.pop_back();
            }
        }
        self.release_shape(gone.state.shape);
    }

    fn drop_oldest(&mut self) {
        let Some(gone) = self.records.pop_front() else { return };
        self.shown.forget_first();
        self.held_log_bytes -= gone.log_bytes;
        // Its handles go on in the next one, where they count from now on.
        if let Some(next) = self.records.front_mut()
            && next.state.handles.id == gone.state.handles.id
        {
            let handles = handle_bytes(&next.state);
            next.log_bytes += handles;
            self.held_log_bytes += handles;
        }
        if gone.state.topology.is_some()
            && let Some(run) = self.runs.front_mut()
        {
            run.commits -= 1;
            if run.commits == 0 {
                self.runs.pop_front();
            }
        }
        self.release_shape(gone.state.shape);
    }

    /// A commit that had a shape is gone; with the last one the shape goes.
    fn release_shape(&mut self, id: RecordedShapeId) {
        let Some(shape) = self.shapes.get_mut(&id) else { return };
        shape.uses -= 1;
        if shape.uses == 0 {
            self.set_snapshot(id, None);
            self.shapes.remove(&id);
        }
    }

    /// Folds the oldest commits away and drops snapshots until the limits hold.
    fn fold_oldest(&mut self) {
        let too_many = |h: &Self| h.records.len() > h.limit.saturating_add(1);
        let too_large = |h: &Self| h.held_log_bytes > LOG_BYTES || h.edit_bytes() > h.snapshot_bytes.max(LOG_BYTES);
        while self.at > 0 && (too_many(self) || (self.at > 1 && too_large(self))) {
            self.drop_oldest();
            self.at -= 1;
        }
        let current = self.current().shape;
        // Undo goes from new to old, so the oldest snapshots are missed last.
        while self.held_snapshot_bytes > self.snapshot_bytes
            && let Some(oldest) = self.snapshots.iter().copied().find(|id| *id != current)
        {
            self.set_snapshot(oldest, None);
        }
    }

    /// Bytes of what edits have made of the model, beyond what the engine holds itself.
    fn edit_bytes(&self) -> u64 {
        let now = self.current().topology.as_ref();
        let others = self.runs.iter().map(|run| &run.topology);
        others
            .filter(|topology| !now.is_some_and(|now| now.is_same(topology)))
            .map(TopologyState::byte_size)
            .sum()
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.held_snapshot_bytes + self.held_log_bytes + self.edit_bytes()
    }

    /// The commits as clients see them.
    pub fn show(&self) -> ShownCommits {
        ShownCommits {
            list: self.shown.clone(),
            current: self.records[self.at].revision,
        }
    }
}

/// Bytes of the poses of handles, about.
fn pose_bytes(poses: &HandlePoses) -> u64 {
    let targets: usize = poses.0.iter().map(HandlePose::target_bytes).sum();
    poses.0.len() as u64 * POSE_BYTES + targets as u64
}

/// Bytes of a state's handles, about.
fn handle_bytes(state: &SessionState) -> u64 {
    state.handles.set.byte_size() as u64
}

#[cfg(test)]
#[path = "commit_history_tests.rs"]
mod tests;
