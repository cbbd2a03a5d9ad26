//! What a commit leaves a session in, and how its shape can be made again.
//!
//! The list of commits, in shared pieces: each change of the session publishes its history, and must not copy ten
//! thousand commits for one.

use crate::stream::frame_window::FrameContext;
use pliant_core::engine::{HandlePoses, HandleSet, ModelShape, PoseChain, SolveSettings, TopologyState};
use pliant_wire::{origin_of, pb};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// This number names a shape of one session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RecordedShapeId(pub u64);

/// This number names a set of handles of one session; two commits with one number have the same handles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct HandleSetId(pub u64);

/// The handles that a commit has set, with their number.
#[derive(Debug)]
pub(crate) struct CommittedHandles {
    pub id: HandleSetId,
    pub set: HandleSet,
}

/// The state that a commit leaves the session in.
#[derive(Debug, Clone)]
pub(crate) struct SessionState {
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
    /// What the engine says about model, solver and handles, with the rotations that were found for these.
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

    /// Render vertices of the model.
    pub fn vertices(&self) -> u32 {
        self.facts.model.as_ref().map_or(0, |m| m.vertices)
    }

    /// What frames of poses in this state share, sent as of `revision` after work that waited `queued`, in parts of so many bytes.
    pub fn frame_context(&self, revision: u64, queued: Duration, part_bytes: usize) -> FrameContext {
        FrameContext {
            revision,
            topology: self.topology.as_ref().map(TopologyState::id),
            diagonal: self.diagonal,
            origin: origin_of(&self.facts),
            queued,
            part_bytes,
        }
    }

    /// About how many points are looked at when `handles` are set in this state.
    pub fn cost_of_handles(&self, handles: &HandleSet) -> u64 {
        let nodes = self.facts.solver.as_ref().map_or(0, |s| s.graph_vertices);
        handles.cost(u64::from(nodes) + u64::from(self.vertices()))
    }
}

/// A pose that was solved, to be committed.
#[derive(Debug, Clone)]
pub(crate) struct PosedState {
    pub chain: PoseChain,
    /// What a user should know of them.
    pub warnings: Vec<pb::Warning>,
    /// The rotations that were found for them.
    pub found_turns: Vec<pb::FoundTurn>,
    /// `None` where it is not at hand: it is solved again when it is asked for.
    pub shape: Option<ModelShape>,
    /// Digest of its positions.
    pub digest: String,
}

/// The state of an engine that an edit has changed, to be committed.
#[derive(Debug)]
pub(crate) struct EditedState {
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
pub(crate) enum ShapeRecipe {
    /// It is the rest shape.
    Rest { topology: Option<TopologyState> },
    /// It is the solution of a pose.
    Solved {
        topology: Option<TopologyState>,
        handles: Arc<CommittedHandles>,
        chain: Arc<PoseChain>,
    },
}

/// Commits of one piece.
const PIECE: usize = 128;

/// A list that grows and shrinks at its end and loses its beginning. A clone shares all pieces; a change copies one at most.
#[derive(Debug, Clone, Default)]
pub(crate) struct CommitList {
    pieces: VecDeque<Arc<Vec<pb::Commit>>>,
    /// How many of the first piece are gone.
    gone: usize,
    length: usize,
}

impl CommitList {
    /// The commits, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &pb::Commit> {
        self.pieces.iter().flat_map(|piece| piece.iter()).skip(self.gone)
    }

    pub(super) fn push(&mut self, commit: pb::Commit) {
        match self.pieces.back_mut().filter(|piece| piece.len() < PIECE) {
            Some(piece) => Arc::make_mut(piece).push(commit),
            None => self.pieces.push_back(Arc::new(vec![commit])),
        }
        self.length += 1;
    }

    /// Forgets the newest commits until so many are left.
    pub(super) fn truncate(&mut self, length: usize) {
        while self.length > length {
            let Some(piece) = self.pieces.back_mut() else { return };
            let kept = piece.len() - (self.length - length).min(piece.len());
            self.length -= piece.len() - kept;
            if kept == 0 {
                self.pieces.pop_back();
            } else {
                Arc::make_mut(piece).truncate(kept);
            }
        }
    }

    /// Replaces the digest of the commit at `index`.
    pub(super) fn set_digest(&mut self, index: usize, digest: &str) {
        let mut at = index + self.gone;
        for piece in &mut self.pieces {
            if at < piece.len() {
                digest.clone_into(&mut Arc::make_mut(piece)[at].digest);
                return;
            }
            at -= piece.len();
        }
    }

    /// Forgets the oldest commit.
    pub(super) fn forget_first(&mut self) {
        let Some(first) = self.pieces.front() else { return };
        self.gone += 1;
        self.length -= 1;
        if self.gone == first.len() {
            self.pieces.pop_front();
            self.gone = 0;
        }
    }
}

#[cfg(test)]
mod commit_list_tests {
    use super::*;
    use proptest::prelude::*;

    fn commit(revision: u64) -> pb::Commit {
        pb::Commit {
            revision,
            kind: "pose".into(),
            digest: revision.to_string(),
        }
    }

    proptest! {
        /// Against a plain list.
        #[test]
        fn it_is_a_list(steps in prop::collection::vec((0u8..4, 1usize..400), 0..40)) {
            let (mut list, mut plain) = (CommitList::default(), VecDeque::<pb::Commit>::new());
            let mut revision = 0;
            for (kind, count) in steps {
                match kind {
                    0 => for _ in 0..count {
                        revision += 1;
                        list.push(commit(revision));
                        plain.push_back(commit(revision));
                    },
                    1 => {
                        let kept = plain.len().saturating_sub(count);
                        // The first commit of a history is never undone.
                        let kept = kept.max(plain.len().min(1));
                        list.truncate(kept);
                        plain.truncate(kept);
                    }
                    2 => if !plain.is_empty() {
                        let at = count % plain.len();
                        list.set_digest(at, "other");
                        plain[at].digest = "other".into();
                    },
                    _ => for _ in 0..count.min(plain.len()) {
                        list.forget_first();
                        plain.pop_front();
                    },
                }
                prop_assert!(list.iter().eq(plain.iter()), "{} and {}", list.length, plain.len());
            }
        }
    }

    #[test]
    fn what_was_shown_stays_and_nearly_all_of_it_is_shared() {
        let mut list = CommitList::default();
        (0..10_000).for_each(|k| list.push(commit(k)));
        let shown = list.clone();
        list.push(commit(10_000));
        list.forget_first();
        let same = shown
            .pieces
            .iter()
            .zip(&list.pieces)
            .filter(|(a, b)| Arc::ptr_eq(a, b))
            .count();
        assert!(same + 1 >= shown.pieces.len(), "{same} of {}", shown.pieces.len());
        assert!(shown.iter().map(|c| c.revision).eq(0..10_000));
        assert!(list.iter().map(|c| c.revision).eq(1..=10_000));
    }
}
