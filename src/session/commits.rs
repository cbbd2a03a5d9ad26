//! The ordered commits of a session: what makes undo, redo and replay possible.
//!
//! A session's state is a pure function of its model and the commits up to the current one. Shapes are kept as snapshots while
//! they fit a budget of bytes; an older one is solved again from its recipe, which gives the same bits. Knows no
//! engine and no task: it is told what was solved.

use crate::engine::{HandlePoses, TopologyState};
use crate::wire::{DeformOptions, pb};
use glam::DVec3;
use prost::Message as _;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Bytes of handles and poses that one session's commits may hold; the oldest are folded before there are more.
const LOG_BYTES: u64 = 64 << 20;

/// Names a shape of one session.
pub(super) type ShapeId = u64;

/// What a commit leaves the session in.
#[derive(Debug, Clone)]
pub(super) struct State {
    /// What edits have made of the model.
    pub trail: Option<TopologyState>,
    /// Length of its bounding box's diagonal.
    pub diagonal: f64,
    /// The handles in force.
    pub handles: Arc<pb::SetHandlesRequest>,
    /// Their poses.
    pub poses: HandlePoses,
    /// What the engine says about model, solver and handles.
    pub facts: Arc<pb::Session>,
    /// The shape.
    pub shape: ShapeId,
    /// Digest of its positions.
    pub digest: String,
}

/// How to make a shape again.
#[derive(Debug, Clone)]
pub(super) enum Recipe {
    /// It is the rest shape.
    Rest { trail: Option<TopologyState> },
    /// It is the solution of these poses.
    Solved {
        trail: Option<TopologyState>,
        handles: Arc<pb::SetHandlesRequest>,
        poses: HandlePoses,
        settings: DeformOptions,
    },
}

/// A commit that can be gone back to.
#[derive(Debug, Clone)]
struct Record {
    revision: u64,
    kind: &'static str,
    state: State,
}

#[derive(Debug)]
struct Shape {
    recipe: Recipe,
    snapshot: Option<Arc<Vec<DVec3>>>,
}

/// The commits of one session. Never empty: the first is the session's creation, or what older commits were folded into.
#[derive(Debug)]
pub(super) struct History {
    records: VecDeque<Record>,
    at: usize,
    revision: u64,
    shapes: BTreeMap<ShapeId, Shape>,
    next_shape: ShapeId,
    limit: usize,
    snapshot_bytes: u64,
}

impl History {
    /// A session just created, at rest. At most `limit` commits can be undone.
    pub fn new(
        facts: pb::Session,
        poses: HandlePoses,
        rest: Arc<Vec<DVec3>>,
        digest: String,
        (trail, diagonal): (Option<TopologyState>, f64),
        limit: usize,
        snapshot_bytes: u64,
    ) -> Self {
        let recipe = Recipe::Rest { trail: trail.clone() };
        let state = State {
            trail,
            diagonal,
            handles: Arc::default(),
            poses,
            facts: Arc::new(facts),
            shape: 0,
            digest,
        };
        Self {
            records: VecDeque::from([Record {
                revision: 1,
                kind: "create",
                state,
            }]),
            at: 0,
            revision: 1,
            shapes: BTreeMap::from([(
                0,
                Shape {
                    recipe,
                    snapshot: Some(rest),
                },
            )]),
            next_shape: 1,
            limit,
            snapshot_bytes,
        }
    }

    /// Number of the newest change.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The state that the session is in.
    pub fn current(&self) -> &State {
        &self.records[self.at].state
    }

    /// Where undo would lead.
    pub fn behind(&self) -> Option<usize> {
        self.at.checked_sub(1)
    }

    /// Where redo would lead.
    pub fn ahead(&self) -> Option<usize> {
        (self.at + 1 < self.records.len()).then_some(self.at + 1)
    }

    /// The state after commit `index`.
    pub fn state(&self, index: usize) -> Option<&State> {
        self.records.get(index).map(|r| &r.state)
    }

    /// A shape's positions, or how to solve them again.
    pub fn shape(&self, id: ShapeId) -> Result<Arc<Vec<DVec3>>, Recipe> {
        let snapshot = self.shapes.get(&id).and_then(|s| s.snapshot.as_ref());
        snapshot.map(Arc::clone).ok_or_else(|| self.recipe(id))
    }

    /// How to make a shape again.
    pub fn recipe(&self, id: ShapeId) -> Recipe {
        match self.shapes.get(&id) {
            Some(shape) => shape.recipe.clone(),
            None => Recipe::Rest {
                trail: self.current().trail.clone(),
            },
        }
    }

    /// Records new handles; the shape stays as it is. What was undone is gone.
    pub fn commit_handles(&mut self, handles: pb::SetHandlesRequest, poses: HandlePoses, facts: pb::Session) {
        let State {
            trail,
            diagonal,
            shape,
            digest,
            ..
        } = self.current().clone();
        let state = State {
            trail,
            diagonal,
            handles: Arc::new(handles),
            poses,
            facts: Arc::new(facts),
            shape,
            digest,
        };
        self.push("handles", state);
    }

    /// Records a solved pose. What was undone is gone.
    pub fn commit_pose(
        &mut self,
        poses: HandlePoses,
        settings: DeformOptions,
        positions: Arc<Vec<DVec3>>,
        digest: String,
    ) {
        let State {
            trail,
            diagonal,
            handles,
            facts,
            ..
        } = self.current().clone();
        let shape = self.next_shape;
        self.next_shape += 1;
        let recipe = Recipe::Solved {
            trail: trail.clone(),
            handles: Arc::clone(&handles),
            poses: poses.clone(),
            settings,
        };
        self.shapes.insert(
            shape,
            Shape {
                recipe,
                snapshot: Some(positions),
            },
        );
        self.push(
            "pose",
            State {
                trail,
                diagonal,
                handles,
                poses,
                facts,
                shape,
                digest,
            },
        );
    }

    /// Records an edit: the state that it left, and how its shape came about. What was undone is gone.
    pub fn commit_edit(&mut self, mut state: State, positions: Arc<Vec<DVec3>>, solved: Option<DeformOptions>) {
        state.shape = self.next_shape;
        self.next_shape += 1;
        let trail = state.trail.clone();
        let recipe = match solved {
            None => Recipe::Rest { trail },
            Some(settings) => Recipe::Solved {
                trail,
                handles: Arc::clone(&state.handles),
                poses: state.poses.clone(),
                settings,
            },
        };
        let snapshot = Some(positions);
        self.shapes.insert(state.shape, Shape { recipe, snapshot });
        self.push("edit", state);
    }

    /// Goes to commit `index`, whose shape is `positions`.
    pub fn go(&mut self, index: usize, positions: Arc<Vec<DVec3>>) {
        self.at = index.min(self.records.len() - 1);
        self.revision += 1;
        if let Some(shape) = self.shapes.get_mut(&self.records[self.at].state.shape) {
            shape.snapshot = Some(positions);
        }
        self.trim();
    }

    fn push(&mut self, kind: &'static str, state: State) {
        self.records.truncate(self.at + 1);
        self.revision += 1;
        self.records.push_back(Record {
            revision: self.revision,
            kind,
            state,
        });
        self.at += 1;
        self.trim();
    }

    /// Folds the oldest commits away and drops snapshots until the limits hold.
    fn trim(&mut self) {
        let too_many = |h: &Self| h.records.len() > h.limit.saturating_add(1);
        let too_large = |h: &Self| h.log_bytes() > LOG_BYTES || h.edit_bytes() > h.snapshot_bytes.max(LOG_BYTES);
        while self.at > 0 && (too_many(self) || (self.at > 1 && too_large(self))) {
            self.records.pop_front();
            self.at -= 1;
        }
        let used: std::collections::BTreeSet<ShapeId> = self.records.iter().map(|r| r.state.shape).collect();
        self.shapes.retain(|id, _| used.contains(id));
        let current = self.current().shape;
        let mut bytes = self.snapshots();
        // Undo goes from new to old, so the oldest snapshots are missed last.
        for (_, shape) in self.shapes.iter_mut().filter(|(id, _)| **id != current) {
            if bytes <= self.snapshot_bytes {
                break;
            }
            let evictable = matches!(shape.recipe, Recipe::Solved { .. });
            if evictable && let Some(positions) = shape.snapshot.take() {
                bytes = bytes.saturating_sub(size_of_val(positions.as_slice()) as u64);
            }
        }
    }

    /// Bytes of the snapshots; the rest shape is the engine's.
    fn snapshots(&self) -> u64 {
        let solved = self
            .shapes
            .values()
            .filter(|s| matches!(s.recipe, Recipe::Solved { .. }));
        solved
            .filter_map(|s| s.snapshot.as_ref())
            .map(|p| size_of_val(p.as_slice()) as u64)
            .sum()
    }

    /// Bytes of what edits have made of the model, beyond what the engine holds itself.
    fn edit_bytes(&self) -> u64 {
        let now = self.current().trail.as_ref();
        let mut last = None;
        let mut bytes = 0;
        for trail in self.records.iter().filter_map(|r| r.state.trail.as_ref()) {
            let known = |other: Option<&TopologyState>| other.is_some_and(|t| t.same(trail));
            if !known(now) && !known(last) {
                bytes += trail.bytes();
            }
            last = Some(trail);
        }
        bytes
    }

    /// Bytes of the handles and poses recorded, about.
    fn log_bytes(&self) -> u64 {
        let mut bytes = 0;
        let mut last: Option<&Arc<pb::SetHandlesRequest>> = None;
        for State { handles, poses, .. } in self.records.iter().map(|r| &r.state) {
            if last.is_none_or(|l| !Arc::ptr_eq(l, handles)) {
                bytes += handles.encoded_len() as u64;
            }
            last = Some(handles);
            bytes += poses.0.len() as u64 * 256;
        }
        bytes
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        self.snapshots() + self.log_bytes() + self.edit_bytes()
    }

    /// The commits as clients see them.
    pub fn describe(&self) -> pb::HistoryResponse {
        let commit = |r: &Record| pb::Commit {
            revision: r.revision,
            kind: r.kind.into(),
            digest: r.state.digest.clone(),
        };
        pb::HistoryResponse {
            commits: self.records.iter().map(commit).collect(),
            current: self.records[self.at].revision,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn settings() -> DeformOptions {
        DeformOptions::check(&pb::Options::default(), "options", 8).expect("defaults")
    }

    fn history(limit: usize, snapshot_bytes: u64) -> History {
        let rest = Arc::new(vec![DVec3::ZERO; 10]);
        History::new(
            pb::Session::default(),
            HandlePoses::default(),
            rest,
            "rest".into(),
            (None, 1.0),
            limit,
            snapshot_bytes,
        )
    }

    fn pose(history: &mut History, x: f64) {
        let positions = Arc::new(vec![DVec3::splat(x); 10]);
        history.commit_pose(HandlePoses::default(), settings(), positions, format!("{x}"));
    }

    #[test]
    fn handles_keep_the_shape_and_undone_commits_go_when_a_new_one_comes() {
        let mut history = history(10, 1 << 20);
        pose(&mut history, 1.0);
        history.commit_handles(
            pb::SetHandlesRequest::default(),
            HandlePoses::default(),
            pb::Session::default(),
        );
        assert_eq!(history.current().digest, "1");
        let back = history.behind().expect("two commits");
        let shape = history
            .shape(history.state(back).expect("kept").shape)
            .expect("snapshot");
        history.go(back, shape);
        assert_eq!(history.ahead(), Some(2));
        pose(&mut history, 2.0);
        let said = history.describe();
        let kinds: Vec<&str> = said.commits.iter().map(|c| c.kind.as_str()).collect();
        assert_eq!((kinds, said.current), (vec!["create", "pose", "pose"], 5));
        assert!(history.ahead().is_none());
    }

    #[test]
    fn old_snapshots_give_way_to_their_recipes_but_not_the_current_one() {
        let mut history = history(10, 500);
        (1..=4).for_each(|x| pose(&mut history, f64::from(x)));
        assert!(history.bytes() <= 500);
        let shape = |index: usize| history.shape(history.state(index).expect("kept").shape);
        assert!(matches!(shape(1), Err(Recipe::Solved { .. })));
        assert_eq!(shape(4).expect("current")[0], DVec3::splat(4.0));
        assert_eq!(shape(0).expect("the rest shape costs nothing")[0], DVec3::ZERO);
    }

    #[test]
    fn the_oldest_commits_are_folded() {
        let mut history = history(2, 1 << 20);
        (1..=5).for_each(|x| pose(&mut history, f64::from(x)));
        let digests: Vec<String> = history.describe().commits.into_iter().map(|c| c.digest).collect();
        assert_eq!(digests, ["3", "4", "5"]);
        assert_eq!(history.shapes.len(), 3);
    }

    proptest! {
        /// Against a plain list of everything that happened: the current digest, the order of the commits and the revision
        /// are what they should be, whatever the order of commands.
        #[test]
        fn any_order_of_commands_keeps_the_books(commands in prop::collection::vec(0u8..4, 0..60), limit in 1usize..6) {
            let mut history = history(limit, 600);
            let (mut model, mut at, mut revision) = (vec![("rest".to_owned(), 1u64)], 0usize, 1u64);
            for (k, command) in commands.into_iter().enumerate() {
                let step = match command {
                    0 => {
                        pose(&mut history, k as f64);
                        Some(format!("{}", k as f64))
                    }
                    1 => {
                        history.commit_handles(Default::default(), HandlePoses::default(), Default::default());
                        Some(model[at].0.clone())
                    }
                    2 => {
                        prop_assert_eq!(history.behind().is_some(), at > 0);
                        if let Some(back) = history.behind() {
                            let shape = history.shape(history.state(back).expect("kept").shape).unwrap_or_default();
                            history.go(back, shape);
                            at -= 1;
                            revision += 1;
                        }
                        None
                    }
                    _ => {
                        prop_assert_eq!(history.ahead().is_some(), at + 1 < model.len());
                        if let Some(next) = history.ahead() {
                            let shape = history.shape(history.state(next).expect("kept").shape).unwrap_or_default();
                            history.go(next, shape);
                            at += 1;
                            revision += 1;
                        }
                        None
                    }
                };
                if let Some(digest) = step {
                    revision += 1;
                    model.truncate(at + 1);
                    model.push((digest, revision));
                    at += 1;
                    if model.len() > limit + 1 {
                        model.remove(0);
                        at -= 1;
                    }
                }
                let said = history.describe();
                prop_assert_eq!(said.current, model[at].1);
                prop_assert_eq!(history.revision(), revision);
                prop_assert_eq!(&history.current().digest, &model[at].0);
                let commits: Vec<_> = said.commits.into_iter().map(|c| (c.digest, c.revision)).collect();
                prop_assert_eq!(&commits, &model);
                prop_assert!(history.shape(history.current().shape).is_ok(), "the current shape is at hand");
            }
        }
    }
}
