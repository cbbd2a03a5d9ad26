//! A session rebuilt from its log, on a compute thread.
//!
//! Handles and poses are put back as they were recorded. Edits, and solves after the newest kept shape, are done again
//! and compared with what was recorded. On the build and processor that recorded them the digests must be the same; on
//! another one the shapes must be close, and the new digests are recorded.

use crate::history::commit_history::CommitHistory;
use crate::history::loaded_deformer::LoadedDeformer;
use crate::history::session_state::{PosedState, ShapeRecipe};
use crate::keeping::kept_session::KeptSession;
use crate::store::{Commit, StoreError};
use glam::DVec3;
use pliant_asset::FileSet;
use pliant_core::engine::{self, ModelShape, digest};
use pliant_exec::Exec;
use pliant_exec::progress;
use pliant_wire::SessionEdit;
use pliant_wire::record::{LoggedCommit, ShapeProbe};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// How far, as a fraction of the diagonal, what another build makes may be from what was recorded: as far as two solves that both
/// meet the default tolerance may be from each other, with room.
pub(crate) const OTHER_BUILD: f64 = 1e-3;

/// Why a replay fails.
#[derive(Debug)]
pub(crate) enum ReplayError {
    Engine(engine::Error),
    Store(StoreError),
}

impl From<engine::Error> for ReplayError {
    fn from(error: engine::Error) -> Self {
        Self::Engine(error)
    }
}

impl From<progress::Cancelled> for ReplayError {
    fn from(_: progress::Cancelled) -> Self {
        Self::Engine(engine::Error::Cancelled)
    }
}

fn damaged(problem: impl Into<String>) -> ReplayError {
    ReplayError::Store(StoreError::Damaged(problem.into()))
}

/// What a session is rebuilt from.
pub(crate) struct ReplayedLog {
    pub commits: Vec<Commit>,
    /// The files of merges, by the number of the commit.
    pub files: BTreeMap<u64, FileSet>,
    /// The newest shape that is kept, after the commit of this number.
    pub snapshot: Option<(u64, Arc<Vec<DVec3>>)>,
}

/// A session being rebuilt.
pub(crate) struct Replay<'a> {
    pub deformer: &'a mut LoadedDeformer,
    pub history: &'a mut CommitHistory,
    pub kept: &'a mut KeptSession,
    /// Bytes that the engine may hold.
    pub room: u64,
    pub exec: &'a Exec<'a>,
    /// New digests to be recorded.
    pub rerecorded: Vec<(u64, String)>,
}

/// What the moves along the commits come to, before anything is done: which commits can be gone to, and how far back undo ever went.
struct ReachableCommits {
    sequences: BTreeSet<u64>,
    depth: usize,
}

fn reachable(commits: &[Commit], limit: usize) -> Result<ReachableCommits, ReplayError> {
    let (mut list, mut at, mut depth): (Vec<(u64, u64)>, usize, usize) = (Vec::new(), 0, 0);
    for commit in commits {
        match commit.record {
            LoggedCommit::Step { target, .. } => {
                at = (list.iter().rposition(|(_, revision)| *revision == target))
                    .ok_or_else(|| damaged(format!("commit {} goes to one that is not there", commit.sequence)))?;
                depth = depth.max(list.len() - 1 - at);
            }
            _ => {
                list.truncate(at + 1);
                list.push((commit.sequence, commit.revision));
                at = list.len() - 1;
            }
        }
    }
    let first = list.len().saturating_sub(limit.saturating_add(1)).min(at);
    let sequences = list[first..].iter().map(|(sequence, _)| *sequence).collect();
    Ok(ReachableCommits { sequences, depth })
}

impl Replay<'_> {
    /// Follows the log from its second commit on; the first is what the engine and the history begin with.
    pub fn follow(&mut self, log: &ReplayedLog, limit: usize) -> Result<(), ReplayError> {
        let Some((first, others)) = log.commits.split_first() else {
            return Err(damaged("the session has no commit"));
        };
        let LoggedCommit::Create { .. } = first.record else {
            return Err(damaged("the session does not begin with its creation"));
        };
        let rest = self.history.current().digest.clone();
        if self.is_new(first, &rest, || true)? {
            self.rerecorded.push((first.sequence, rest));
        }
        let reachable = reachable(&log.commits, limit)?;
        self.history.set_limit(limit.max(reachable.depth));
        let kept_at = log.snapshot.as_ref().map_or(0, |(sequence, _)| *sequence);
        for commit in others {
            let is_solved = commit.sequence > kept_at && reachable.sequences.contains(&commit.sequence);
            self.follow_commit(commit, &log.files, is_solved)?;
            self.kept.sequence = commit.sequence;
            if self.history.revision() != commit.revision {
                return Err(damaged(format!("commit {} is out of order", commit.sequence)));
            }
        }
        self.bring_current_shape(log)?;
        self.history.set_limit(limit);
        let state = self.history.current().clone();
        Ok(self
            .deformer
            .load_state(state.topology.as_ref(), &state.handles, self.exec)?)
    }

    fn follow_commit(
        &mut self,
        stored: &Commit,
        files: &BTreeMap<u64, FileSet>,
        is_solved: bool,
    ) -> Result<(), ReplayError> {
        self.exec.check()?;
        let from = self.history.current_revision();
        let place = self.kept.place_after(&stored.record, from, stored.sequence);
        match &stored.record {
            LoggedCommit::Create { .. } => return Err(damaged("the session was created twice")),
            LoggedCommit::Handles { set, poses, facts } => {
                let mut facts = facts.clone();
                // Facts of the time before joints name none.
                for handle in facts.handles.iter_mut().filter(|handle| handle.pivot.is_empty()) {
                    handle.pivot.clone_from(&handle.centroid);
                }
                self.history.commit_handles(set.clone(), poses.clone(), facts);
            }
            LoggedCommit::Pose {
                chain,
                warnings,
                found_turns,
                probe,
                ..
            } => {
                let state = self.history.current().clone();
                if chain.pose.poses.0.len() != state.handles.set.handles.len() {
                    return Err(damaged(format!(
                        "commit {} has poses of other handles",
                        stored.sequence
                    )));
                }
                let mut shape = None;
                let mut now = stored.digest.clone();
                if is_solved {
                    let recipe = ShapeRecipe::Solved {
                        topology: state.topology.clone(),
                        handles: Arc::clone(&state.handles),
                        chain: Arc::new(chain.clone()),
                    };
                    let solved = self.deformer.solve_recipe(&recipe, self.exec)?;
                    now = self.compare(stored, probe, &solved.positions, state.diagonal)?;
                    shape = Some(solved);
                }
                self.history.commit_pose(PosedState {
                    chain: chain.clone(),
                    warnings: warnings.clone(),
                    found_turns: found_turns.clone(),
                    shape,
                    digest: now,
                });
            }
            LoggedCommit::Edit { edit, probe, .. } => {
                let mut edit = (**edit).clone();
                if let (Some(other), Some(files)) = (edit.edit.other_model_mut(), files.get(&stored.sequence)) {
                    other.files = files.clone();
                }
                self.follow_edit(stored, &edit, probe)?;
            }
            LoggedCommit::Step { target, .. } => {
                let gone = || damaged(format!("commit {} goes to one that is not there", stored.sequence));
                let index = self.history.index_of(*target).ok_or_else(gone)?;
                self.history.go_to_commit(index, None);
                return Ok(());
            }
        }
        self.kept.places.insert(stored.revision, place);
        Ok(())
    }

    fn follow_edit(&mut self, stored: &Commit, edit: &SessionEdit, probe: &ShapeProbe) -> Result<(), ReplayError> {
        let state = self.history.current().clone();
        let recipe = self.history.recipe(state.shape);
        let shape = self.history.shape(state.shape).ok();
        self.deformer.room = self.room;
        let (mut edited, shape, _) = self.deformer.edit_state(&state, shape, &recipe, edit, self.exec)?;
        edited.digest = self.compare(stored, probe, &shape.positions, edited.diagonal)?;
        self.history.commit_edit(edited, shape);
        self.deformer.adopt_handles(self.history.current().handles.id);
        Ok(())
    }

    /// The current shape has to be at hand: kept, or solved again.
    fn bring_current_shape(&mut self, log: &ReplayedLog) -> Result<(), ReplayError> {
        let state = self.history.current().clone();
        let Err(recipe) = self.history.shape(state.shape) else {
            return Ok(());
        };
        if let Some((_, positions)) = &log.snapshot
            && digest(positions) == state.digest
        {
            let shape = ModelShape::from_positions(Arc::clone(positions));
            self.history.keep_current_shape(shape);
            return Ok(());
        }
        let shape = self.deformer.solve_recipe(&recipe, self.exec)?;
        let at = self.kept.place(self.history.current_revision()).shape_at;
        let stored = log.commits.iter().find(|c| c.sequence == at);
        if let Some(stored) = stored {
            let probe = match &stored.record {
                LoggedCommit::Pose { probe, .. } | LoggedCommit::Edit { probe, .. } => probe.clone(),
                _ => ShapeProbe::of(&shape.positions),
            };
            let now = self.compare(stored, &probe, &shape.positions, state.diagonal)?;
            if let Some(index) = self.history.index_of(self.history.current_revision()) {
                self.history.record_digest(index, &now);
            }
        }
        self.history.keep_current_shape(shape);
        Ok(())
    }

    /// Compares a shape with what was recorded of it; its digest.
    fn compare(
        &mut self,
        stored: &Commit,
        probe: &ShapeProbe,
        positions: &[DVec3],
        diagonal: f64,
    ) -> Result<String, ReplayError> {
        let now = digest(positions);
        let is_close = || probe.is_close_to(positions, OTHER_BUILD * diagonal);
        if self.is_new(stored, &now, is_close)? && !self.rerecorded.iter().any(|(n, _)| *n == stored.sequence) {
            self.rerecorded.push((stored.sequence, now.clone()));
        }
        Ok(now)
    }

    /// Whether another build's digest is to be replaced.
    fn is_new(&self, stored: &Commit, now: &str, is_close: impl FnOnce() -> bool) -> Result<bool, ReplayError> {
        let is_own = stored.build == self.kept.build;
        check_digest(stored, now, is_own, is_close).map_err(ReplayError::Store)?;
        Ok(!is_own)
    }
}

/// Whether a rebuilt shape may stand for the recorded one.
pub(crate) fn check_digest(
    stored: &Commit,
    now: &str,
    is_own: bool,
    is_close: impl FnOnce() -> bool,
) -> Result<(), StoreError> {
    let (number, was) = (stored.sequence, &stored.digest);
    if now == was {
        return Ok(());
    }
    if is_own {
        return Err(StoreError::Damaged(format!(
            "commit {number} made again has the digest {now}, {was} was recorded"
        )));
    }
    if is_close() {
        return Ok(());
    }
    Err(StoreError::Refused(format!(
        "commit {number} was made by another build ({}), and this one makes another shape of it; use that build to export the session",
        stored.build
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn commit(sequence: u64, target: Option<u64>) -> Commit {
        let pose = LoggedCommit::Pose {
            chain: Default::default(),
            warnings: Vec::new(),
            found_turns: Vec::new(),
            probe: ShapeProbe::default(),
            frame: None,
        };
        Commit {
            sequence,
            revision: sequence + 1,
            digest: String::new(),
            build: String::new(),
            facts_at: 0,
            poses_at: 0,
            record: target.map_or(pose, |target| LoggedCommit::Step { target, forward: false }),
        }
    }

    fn left(moves: &[Option<u64>], limit: usize) -> (Vec<u64>, usize) {
        let commits: Vec<_> = (0..).zip(moves).map(|(k, target)| commit(k, *target)).collect();
        let found = reachable(&commits, limit).expect("every target is there");
        (found.sequences.into_iter().collect(), found.depth)
    }

    #[test]
    fn what_can_be_gone_to_follows_from_the_moves() {
        assert_eq!(left(&[None, None, None], 9), (vec![0, 1, 2], 0));
        assert_eq!(left(&[None, None, None], 1), (vec![1, 2], 0));
        // Undo twice, then something else: both are gone.
        assert_eq!(left(&[None, None, None, Some(2), Some(1), None], 9), (vec![0, 5], 2));
        // What is undone can be gone to again, and the current one is never folded.
        assert_eq!(left(&[None, None, None, Some(1)], 1), (vec![0, 1, 2], 2));
        let wrong = [commit(0, None), commit(1, Some(7))];
        assert!(matches!(
            reachable(&wrong, 9),
            Err(ReplayError::Store(StoreError::Damaged(_)))
        ));
    }
}
