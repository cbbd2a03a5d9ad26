//! The commits of a session on their way to the store. A commit is kept before it becomes the session's state, so that one which
//! cannot be kept has never happened.
//!
//! Commits that were made before: the frame of one is made again from its shape, and a commit of a stream that comes a second
//! time is answered with it.

use crate::answers::CommittedPose;
use crate::audit::audit_entry::{AuditEntry, AuditedAction};
use crate::calls::command::{HistoryDirection, StoredAnswer, WorkOrder};
use crate::calls::idempotency::{ClaimOutcome, KeyClaim, RequestFingerprint, answer_of_another_call};
use crate::calls::model_opening::announce_stored;
use crate::calls::shared_keys::claim_everywhere;
use crate::error::{Error, ErrorCode};
use crate::history::session_state::{EditedState, PosedState};
use crate::keeping::heartbeat::refuse_stale_state;
use crate::keeping::replay::{OTHER_BUILD, check_digest};
use crate::store::{Commit, NewCommit, StoreError, write_shape};
use crate::task::session_task::SessionTask;
use pliant_asset::FileSet;
use pliant_core::engine;
use pliant_core::engine::{ModelShape, TopologyState};
use pliant_wire::frames::Frame;
use pliant_wire::record::{AnsweredFrame, LoggedCommit, ShapeProbe};
use pliant_wire::{PoseKey, SessionEdit, origin_of, pb};
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
            chain: posed.chain.clone(),
            warnings: posed.warnings.clone(),
            found_turns: posed.found_turns.clone(),
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
        shape: &ModelShape,
        report: &pb::EditResult,
        claim: Option<&Claim>,
    ) -> Result<(), Error> {
        let (Some(mut asked), Some(_)) = (asked, &self.kept) else {
            self.log_change(AuditedAction::Edit);
            return Ok(());
        };
        let files: Option<FileSet> = match asked.edit.other_model_mut() {
            Some(other) => Some(std::mem::take(&mut other.files)),
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
        if let Err(error) = kept.store.append(new).await {
            self.shared.metrics.store_failures.inc();
            tracing::error!(session.id = %self.session.id, "a commit could not be stored: {error}");
            if error == StoreError::Moved {
                self.shared.drop_ownership(&self.session);
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
            if store.is_writable()
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
        if store.is_writable() {
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
        let stored = store.commit(&id, at).await?.ok_or_else(damaged)?;
        let is_close = || match &stored.record {
            LoggedCommit::Pose { probe, .. } | LoggedCommit::Edit { probe, .. } => {
                probe.is_close_to(&shape.positions, OTHER_BUILD * diagonal)
            }
            _ => true,
        };
        check_digest(&stored, now, stored.build == build, is_close)?;
        if store.is_writable() {
            let digests = vec![(at, now.to_owned())];
            store
                .rerecord_digests(self.session.held.clone(), &build, digests)
                .await?;
        }
        self.history.record_digest(index, now);
        Ok(())
    }
}

impl SessionTask {
    /// Claims the key of a commit on a stream, or gives the answer that is kept for it. Commits of one session take turns, so the
    /// one before has either been recorded or left its key free.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` for a key that was used with other handles.
    pub async fn claim_stream_commit(&mut self, key: &PoseKey) -> Result<ClaimOutcome<StoredAnswer>, Error> {
        refuse_stale_state(&self.shared)?;
        let parts = [self.session.id.as_bytes(), key.request.as_slice()];
        let fingerprint = RequestFingerprint::of("stream_commit", &parts);
        claim_everywhere(&self.shared, &self.session.tenant, &key.key, fingerprint).await
    }

    /// The frame that a commit was answered with, as the answer to the pose of number `seq`.
    ///
    /// # Errors
    /// `ALREADY_EXISTS` when it was recorded and cannot be gone to any more; errors of the store.
    pub async fn recall_answer(
        &mut self,
        answer: StoredAnswer,
        seq: u64,
        order: impl Fn() -> WorkOrder,
    ) -> Result<Frame, Error> {
        let committed = match answer {
            StoredAnswer::Solved(committed) => *committed,
            StoredAnswer::Recorded { session, sequence } => {
                let gone = || {
                    let text = "the commit with this idempotency key was recorded, but can no longer be gone to";
                    Error::new(ErrorCode::AlreadyExists, text)
                };
                let kept = self.kept.as_ref().ok_or_else(answer_of_another_call)?;
                let store = Arc::clone(&kept.store);
                let stored = store.commit(&session, sequence).await?.ok_or_else(gone)?;
                let LoggedCommit::Pose { frame: Some(frame), .. } = stored.record else {
                    return Err(answer_of_another_call());
                };
                let recalled = self.recall(stored.revision, *frame, order).await?;
                recalled.ok_or_else(gone)?
            }
            _ => return Err(answer_of_another_call()),
        };
        let mut frame = committed.frame;
        frame.header.seq = seq;
        frame.diagonal = self.history.current().diagonal;
        Ok(frame)
    }

    /// The frame of a pose that was committed with this revision.
    pub async fn recall(
        &mut self,
        revision: u64,
        frame: AnsweredFrame,
        order: impl Fn() -> WorkOrder,
    ) -> Result<Option<CommittedPose>, Error> {
        let Some(index) = self.history.index_of(revision) else {
            return Ok(None);
        };
        let Some(shape) = self.shape_of_commit(index, order()).await? else {
            return Ok(None);
        };
        let Some(state) = self.history.state(index) else {
            return Ok(None);
        };
        let (digest, diagonal, topology) = (state.digest.clone(), state.diagonal, state.topology.clone());
        let origin = origin_of(&state.facts);
        let AnsweredFrame { mut header, output } = frame;
        header.revision = revision;
        let id = topology.as_ref().map(TopologyState::id);
        let part_bytes = self.shared.config.part_bytes;
        let (made, watch) = self
            .compute(order(), move |deformer, work| {
                deformer.go_to_topology(topology.as_ref(), &work.exec())?;
                let gradients = deformer.gradients(&shape.positions, output, &work.exec())?;
                let is_shaded = output.normals || output.tangents;
                let shading = is_shaded.then(|| Arc::new(deformer.shader().shade(&shape.positions)));
                let frame = Frame {
                    header,
                    topology: id,
                    diagonal,
                    origin,
                    positions: shape.positions,
                    shading,
                    gradients,
                    output,
                    part_bytes,
                    ..Frame::default()
                };
                Ok::<_, engine::Error>(frame.for_new_reader())
            })
            .await?;
        let frame = made.map_err(|e| self.failure(e, &watch))?;
        Ok(Some(CommittedPose {
            frame,
            revision,
            digest,
        }))
    }
}
