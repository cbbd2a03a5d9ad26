//! The commits of a session on their way to the store. A commit is kept before it becomes the session's state, so that one which
//! cannot be kept has never happened.

use crate::asset::FileSet;
use crate::engine::{Edit, ModelShape};
use crate::session::audit::audit_entry::{AuditEntry, AuditedAction};
use crate::session::calls::command::{HistoryDirection, StoredAnswer};
use crate::session::calls::idempotency::KeyClaim;
use crate::session::calls::session_places::announce_stored;
use crate::session::error::{Error, ErrorCode};
use crate::session::history::session_state::{EditedState, PosedState};
use crate::session::keeping::replay::{OTHER_BUILD, check_digest};
use crate::session::store::{Commit, NewCommit, StoreError, write_shape};
use crate::session::task::session_task::SessionTask;
use crate::wire::frames::Frame;
use crate::wire::record::{AnsweredFrame, LoggedCommit, ShapeProbe};
use crate::wire::{SessionEdit, pb};
use std::sync::Arc;

/// Solved commits after which the newest shape is kept, so that opening solves few of them again.
const SOLVED_PER_SHAPE: u32 = 16;

type Claim = KeyClaim<StoredAnswer>;

impl SessionTask {
    /// Keeps new handles.
    pub async fn keep_handles(
        &mut self,
        commit: impl FnOnce() -> LoggedCommit,
        claim: Option<&Claim>,
    ) -> Result<(), Error> {
        if self.kept.is_none() {
            self.log_change(AuditedAction::Handles);
            return Ok(());
        }
        let digest = self.history.current().digest.clone();
        self.keep(commit(), digest, None, claim).await
    }

    /// Keeps a solved pose. A call with a key can be answered with `frame` again.
    pub async fn keep_pose(&mut self, posed: &PosedState, frame: &Frame, claim: Option<&Claim>) -> Result<(), Error> {
        if self.kept.is_none() {
            self.log_change(AuditedAction::Pose);
            return Ok(());
        }
        let commit = LoggedCommit::Pose {
            poses: posed.poses.clone(),
            settings: posed.settings.clone(),
            warnings: posed.warnings.clone(),
            probe: ShapeProbe::of(&frame.positions),
            frame: claim.map(|_| {
                Box::new(AnsweredFrame {
                    header: frame.header.clone(),
                    output: frame.output,
                })
            }),
        };
        self.keep(commit, posed.digest.clone(), None, claim).await
    }

    /// Keeps an edit: the request, the state after it, its shape and its report.
    pub async fn keep_edit(
        &mut self,
        asked: Option<SessionEdit>,
        edited: &EditedState,
        (shape, report): (&ModelShape, &pb::EditResult),
        claim: Option<&Claim>,
    ) -> Result<(), Error> {
        let (Some(mut asked), Some(_)) = (asked, &self.kept) else {
            self.log_change(AuditedAction::Edit);
            return Ok(());
        };
        let files: Option<FileSet> = match &mut asked.edit {
            Edit::Merge(merge) => Some(std::mem::take(&mut merge.files)),
            _ => None,
        };
        let commit = LoggedCommit::Edit {
            edit: Box::new(asked),
            files: None,
            report: Box::new(report.clone()),
            poses: edited.poses.clone(),
            facts: edited.facts.clone(),
            probe: ShapeProbe::of(&shape.positions),
        };
        self.keep(commit, edited.digest.clone(), files, claim).await
    }

    /// Keeps a step to commit `index`, whose shape has this digest.
    pub async fn keep_step(
        &mut self,
        direction: HistoryDirection,
        index: usize,
        claim: Option<&Claim>,
    ) -> Result<(), Error> {
        let forward = direction == HistoryDirection::Redo;
        if self.kept.is_none() {
            self.log_change(if forward {
                AuditedAction::Redo
            } else {
                AuditedAction::Undo
            });
            return Ok(());
        }
        let (Some(target), Some(state)) = (self.history.revision_of(index), self.history.state(index)) else {
            return Ok(());
        };
        let digest = state.digest.clone();
        self.keep(LoggedCommit::Step { target, forward }, digest, None, claim)
            .await
    }

    fn change(&self, what: AuditedAction) -> AuditEntry {
        AuditEntry {
            tenant: self.session.tenant.clone(),
            who: Arc::clone(&self.acting),
            what,
            session: self.session.id.clone(),
        }
    }

    /// A change that no store notes.
    fn log_change(&self, what: AuditedAction) {
        self.change(what).log();
    }

    async fn keep(
        &mut self,
        commit: LoggedCommit,
        digest: String,
        files: Option<FileSet>,
        claim: Option<&Claim>,
    ) -> Result<(), Error> {
        let merged = files.as_ref().map_or(0, FileSet::total_bytes);
        let storing = announce_stored(&self.shared, self.place.account(), merged).await?;
        let audit = self.change(AuditedAction::of_commit(&commit));
        let Some(kept) = &mut self.kept else { return Ok(()) };
        let (sequence, revision) = (kept.sequence + 1, self.history.revision() + 1);
        let place = kept.place_after(&commit, self.history.current_revision(), sequence);
        let is_step = matches!(commit, LoggedCommit::Step { .. });
        let is_solved = matches!(commit, LoggedCommit::Pose { .. });
        let new = NewCommit {
            session: self.session.held.clone(),
            commit: Commit {
                sequence,
                revision,
                digest,
                build: kept.build.clone(),
                facts_at: place.facts_at,
                poses_at: place.poses_at,
                record: commit,
            },
            files,
            key: claim.map(KeyClaim::logged),
            audit,
        };
        let stored = match kept.store.writable() {
            Ok(store) => store.append(new).await,
            Err(error) => Err(error),
        };
        if let Err(error) = stored {
            self.shared.metrics.store_failures.inc();
            tracing::error!(session.id = %self.session.id, "a commit could not be stored: {error}");
            if error == StoreError::Moved {
                self.shared.lose(&self.session);
            }
            return Err(error.into());
        }
        drop(storing);
        kept.sequence = sequence;
        kept.solved_since += u32::from(is_solved);
        if !is_step {
            kept.places.insert(revision, place);
            let oldest = self.history.oldest_revision();
            kept.places = kept.places.split_off(&oldest);
        }
        Ok(())
    }

    /// Keeps the newest shape, beside the session's work, when enough was solved since the last one that was kept.
    pub fn keep_shape_in_time(&mut self) {
        let held = self.session.held.clone();
        let Some(kept) = self.kept.as_mut().filter(|k| k.solved_since >= SOLVED_PER_SHAPE) else {
            return;
        };
        let at = kept.place(self.history.current_revision()).shape_at;
        kept.solved_since = 0;
        kept.shape_at = at;
        let (store, positions) = (Arc::clone(&kept.store), Arc::clone(&self.session.view().positions));
        let shared = Arc::clone(&self.shared);
        tokio::spawn(async move {
            let Ok(shape) = shared.compute.offload(move || write_shape(&positions)).await else {
                return;
            };
            if let Ok(store) = store.writable()
                && let Err(error) = store.save_snapshot(held, at, shape).await
            {
                tracing::warn!("a shape could not be stored, its commits can: {error}");
            }
        });
    }

    /// Keeps the newest shape now, unless it is kept already or is the rest shape.
    pub async fn keep_shape_now(&mut self) -> Result<(), Error> {
        let Some(kept) = &mut self.kept else { return Ok(()) };
        let at = kept.place(self.history.current_revision()).shape_at;
        if at == kept.shape_at || !self.history.is_solved() {
            return Ok(());
        }
        let positions = Arc::clone(&self.session.view().positions);
        let shape = self.shared.compute.offload(move || write_shape(&positions)).await?;
        let store = Arc::clone(&kept.store);
        if let Ok(store) = store.writable() {
            store.save_snapshot(self.session.held.clone(), at, shape).await?;
        }
        kept.shape_at = at;
        kept.solved_since = 0;
        Ok(())
    }

    /// A shape that was solved again has another digest than its commit. That is damage where this build and processor
    /// recorded it; a shape of another one must be close, and its digest is replaced.
    pub async fn check_solved_again(
        &mut self,
        index: usize,
        now: &str,
        shape: &ModelShape,
        diagonal: f64,
    ) -> Result<(), Error> {
        let damaged = || {
            let text = "a shape of the history, solved again, is not the one that was committed; it is not served";
            Error::new(ErrorCode::DataLoss, text)
        };
        let revision = self.history.revision_of(index).ok_or_else(damaged)?;
        let kept = self.kept.as_ref().ok_or_else(damaged)?;
        let at = kept.place(revision).shape_at;
        let (store, id, build) = (Arc::clone(&kept.store), self.session.id.clone(), kept.build.clone());
        let stored = store.commit(id, at).await?.ok_or_else(damaged)?;
        let is_close = || match &stored.record {
            LoggedCommit::Pose { probe, .. } | LoggedCommit::Edit { probe, .. } => {
                probe.is_close_to(&shape.positions, OTHER_BUILD * diagonal)
            }
            _ => true,
        };
        check_digest(&stored, now, stored.build == build, is_close)?;
        if let Ok(store) = store.writable() {
            let digests = vec![(at, now.to_owned())];
            store
                .rerecord_digests(self.session.held.clone(), build, digests)
                .await?;
        }
        self.history.record_digest(index, now);
        Ok(())
    }
}
