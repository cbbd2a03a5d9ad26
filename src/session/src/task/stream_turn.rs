//! One turn of a deform stream: the waiting poses are checked and merged, the newest is solved, its frame goes out.

use crate::answers::CommittedPose;
use crate::calls::command::{StoredAnswer, WorkOrder};
use crate::calls::idempotency::{ClaimOutcome, KeyClaim};
use crate::capacity::compute_slots::WorkLane;
use crate::capacity::work_watch::Work;
use crate::capacity::work_watch::WorkKind;
use crate::engine::Engine;
use crate::error::Error;
use crate::history::loaded_deformer::{LoadedDeformer, PoseAnswer};
use crate::history::session_state::{PosedState, SessionState};
use crate::stream::frame_window::{FrameContext, ms_of};
use crate::stream::mailbox::Mailbox;
use crate::stream::waiting_poses::{DraggedPoses, PoseEntries, WaitingPose};
use crate::task::commands::lane_of_commit;
use crate::task::session_task::{SessionTask, no_handles};
use pliant_core::engine::{
    self, COMMIT_REFINE, HandlePose, HandlePoses, PoseChain, PoseRecipe, Quality, SolveMode, SolveSettings, SolveUpdate,
};
use pliant_wire::frames::Frame;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The pose of a turn that was solved, or why it was not; the others are settled.
struct SolvedTurn {
    seq: u64,
    /// What the stream has dragged with it.
    dragged: DraggedPoses,
    answer: Result<PoseAnswer, engine::Error>,
}

/// What a turn works with on a compute thread.
struct TurnContext {
    mailbox: Arc<Mailbox>,
    state: SessionState,
    frames: FrameContext,
    /// What poses that wait go on from, by revision.
    starts: BTreeMap<u64, Result<Vec<PoseRecipe>, engine::Error>>,
    /// The longest solve.
    longest: Duration,
}

impl SessionTask {
    /// Serves one stream once.
    pub async fn serve_stream(&mut self, mailbox: Arc<Mailbox>, poses: Vec<WaitingPose>) {
        let state = self.history.current().clone();
        let dragged = mailbox.dragged_poses();
        let before = dragged.clone();
        self.acting = Arc::clone(&mailbox.who);
        if state.handles.set.handles.is_empty() {
            return refuse_all(&mailbox, &poses, before, &no_handles());
        }
        let unsolved = without_entries(&poses);
        let claim = match poses.last().and_then(|p| p.key.as_ref()) {
            None => None,
            Some(key) => match self.claim_stream_commit(key).await {
                Ok(ClaimOutcome::New(claim)) => Some(claim),
                Ok(ClaimOutcome::Done(answer)) => return self.answer_again(&mailbox, &poses, before, answer).await,
                Err(error) => return refuse_all(&mailbox, &poses, before, &error),
            },
        };
        let committed = poses.last().filter(|p| p.commit);
        let commit = committed.is_some();
        let lane = committed.map_or(WorkLane::Drags, |p| lane_of_commit(&state, &p.settings));
        let longest = self.shared.config.solve;
        // A drag takes its best result in time; only one that has none after twice the time is given up.
        let limit = if commit { longest } else { longest.saturating_mul(2) };
        let (revision, part_bytes) = (self.history.revision(), self.shared.config.part_bytes);
        let revisions = poses.iter().filter_map(|pose| pose.settings.from_revision);
        let starts = revisions
            .map(|from| (from, self.history.starts_from(Some(from))))
            .collect();
        let stream = Arc::clone(&mailbox);
        let order = WorkOrder {
            lane,
            ..turn_order(&mailbox, commit, limit)
        };
        let ran = self
            .compute(order, move |deformer, work| {
                let frames = state.frame_context(revision, work.queued, part_bytes);
                let turn = TurnContext {
                    mailbox: stream,
                    state,
                    frames,
                    starts,
                    longest,
                };
                turn.solve_newest(deformer, work, poses, dragged)
            })
            .await;
        let (turn, watch) = match ran {
            Ok(ran) => ran,
            Err(error) => return refuse_all(&mailbox, &unsolved, before, &error),
        };
        let SolvedTurn { seq, dragged, answer } = match turn {
            Ok(Some(turn)) => turn,
            Ok(None) => return mailbox.complete_work(before, None),
            Err(error) => return refuse_all(&mailbox, &unsolved, before, &self.failure(error, &watch)),
        };
        let PoseAnswer { frame, cycles, commit } = match answer {
            Ok(answer) => answer,
            Err(error) => return refuse_pose(&mailbox, seq, before, self.failure(error, &watch)),
        };
        match commit {
            None => {
                self.count_solve(&frame, cycles);
                mailbox.complete_work(dragged, Some(frame));
                self.settle_drag(&mailbox).await;
            }
            Some(posed) => match self.record(posed, &frame, cycles, claim).await {
                // What was dragged is in the commit now.
                Ok(()) => mailbox.complete_work(DraggedPoses::new(), Some(frame)),
                Err(error) => refuse_pose(&mailbox, seq, before, error),
            },
        }
    }

    /// Works ahead once a frame is out, where that has left much undone. Done whether another pose waits by now or not, so that
    /// frames depend on poses and not on time.
    async fn settle_drag(&mut self, mailbox: &Mailbox) {
        let deformer = self.deformer.as_mut().and_then(|loaded| loaded.engine.deformer());
        if !deformer.is_some_and(|deformer| deformer.is_worth_settling()) {
            return;
        }
        let order = WorkOrder {
            kind: WorkKind::Settle,
            ..turn_order(mailbox, false, self.shared.config.solve)
        };
        let ran = self.compute(order, |loaded, work| loaded.deformer("settling")?.settle(&work.exec()));
        // Nothing is lost where it came to nothing: the next pose begins from the frame that is out.
        match ran.await {
            Ok((Ok(()), _)) => {}
            Ok((Err(error), _)) => tracing::debug!(%error, "a drag was not worked ahead"),
            Err(error) => tracing::debug!(%error, "a drag was not worked ahead"),
        }
    }

    /// Keeps a solved pose and commits it; its key, if it has one, stands for `frame` from now on.
    async fn record(
        &mut self,
        posed: PosedState,
        frame: &Frame,
        cycles: u32,
        claim: Option<KeyClaim<StoredAnswer>>,
    ) -> Result<(), Error> {
        let digest = self.commit_pose(posed, frame, cycles, claim.as_ref()).await?;
        if let Some(claim) = claim {
            let answer = StoredAnswer::Solved(Box::new(CommittedPose {
                frame: frame.clone().for_new_reader(),
                revision: self.history.revision(),
                digest,
            }));
            let bytes = answer.byte_size();
            claim.complete(answer, bytes);
        }
        Ok(())
    }

    /// Answers a commit that was recorded before. The drags that waited with it are part of it.
    async fn answer_again(
        &mut self,
        mailbox: &Mailbox,
        poses: &[WaitingPose],
        before: DraggedPoses,
        answer: StoredAnswer,
    ) {
        let Some(commit) = poses.last() else { return };
        let limit = self.shared.config.build;
        let order = || WorkOrder {
            kind: WorkKind::Recall,
            call: mailbox.span.clone(),
            lane: WorkLane::Interactive,
            flag: Arc::clone(&mailbox.cancel),
            arrived: Instant::now(),
            limit,
        };
        match self.recall_answer(answer, commit.seq, order).await {
            Ok(frame) => {
                let others: u32 = poses.iter().filter(|p| !p.more).map(|p| p.poses).sum();
                mailbox.settle_unsolved(Vec::new(), others.saturating_sub(1));
                mailbox.complete_work(DraggedPoses::new(), Some(frame));
            }
            Err(error) => refuse_all(mailbox, poses, before, &error),
        }
    }
}

/// The work of a turn. A drag comes before what does not go on at once.
fn turn_order(mailbox: &Mailbox, commit: bool, limit: Duration) -> WorkOrder {
    let (kind, lane) = match commit {
        true => (WorkKind::Solve, WorkLane::Interactive),
        false => (WorkKind::Drag, WorkLane::Drags),
    };
    WorkOrder {
        kind,
        call: mailbox.span.clone(),
        lane,
        flag: Arc::clone(&mailbox.cancel),
        arrived: Instant::now(),
        limit,
    }
}

/// What is needed of poses to say what became of them.
fn without_entries(poses: &[WaitingPose]) -> Vec<WaitingPose> {
    let bare = |p: &WaitingPose| WaitingPose {
        entries: Vec::new(),
        ..p.clone()
    };
    poses.iter().map(bare).collect()
}

fn refuse_all(mailbox: &Mailbox, poses: &[WaitingPose], dragged: DraggedPoses, error: &Error) {
    let merged = poses.iter().map(|p| p.poses - 1).sum();
    mailbox.settle_unsolved(poses.iter().map(|p| (p.seq, error.clone())).collect(), merged);
    mailbox.complete_work(dragged, None);
}

/// Ends the work on poses of which all but one are settled: that one is refused.
fn refuse_pose(mailbox: &Mailbox, seq: u64, dragged: DraggedPoses, error: Error) {
    mailbox.settle_unsolved(vec![(seq, error)], 0);
    mailbox.complete_work(dragged, None);
}

impl TurnContext {
    /// Checks and merges `poses` on top of what is in force, then solves the newest one that is right; `None` when none is.
    fn solve_newest(
        &self,
        deformer: &mut LoadedDeformer,
        work: &Work<'_>,
        poses: Vec<WaitingPose>,
        mut dragged: DraggedPoses,
    ) -> Result<Option<SolvedTurn>, engine::Error> {
        let state = &self.state;
        deformer.load_state(state.topology.as_ref(), &state.handles, &work.exec())?;
        let before: Vec<_> = dragged.iter().map(|(id, pose)| (id.clone(), pose.clone())).collect();
        let mut merged = deformer.engine.change_poses(&state.poses, &before)?;
        let mut refused = Vec::new();
        let mut superseded = 0u32;
        let mut newest: Option<WaitingPose> = None;
        // Why a part of the next pose was refused, which it is not solved without.
        let mut missing = None;
        for mut pose in poses {
            let others = pose.poses.saturating_sub(1);
            let entries = std::mem::take(&mut pose.entries);
            let changes = match missing.take_if(|_| !pose.more) {
                Some(error) => Err(error),
                None => valid_changes(deformer.engine.as_ref(), &merged, entries, others > 0),
            };
            match changes {
                Ok((changes, changed)) => {
                    merged = changed;
                    let whole = changes
                        .into_iter()
                        .map(|(id, pose)| with_whole_targets(state, &merged, id, pose));
                    dragged.extend(whole);
                    let skipped = match pose.more {
                        true => 0,
                        false => newest.replace(pose).map_or(0, |_| 1),
                    };
                    superseded = superseded.saturating_add(skipped);
                }
                Err(error) => {
                    if pose.more {
                        missing = Some(error.clone());
                    }
                    refused.push((pose.seq, error));
                }
            }
            superseded = superseded.saturating_add(others);
        }
        self.mailbox.settle_unsolved(refused, superseded);
        let Some(pose) = newest else {
            return Ok(None);
        };
        let answer = if pose.commit {
            let frames = FrameContext {
                revision: self.frames.revision + 1,
                ..self.frames.clone()
            };
            let chain = self.chain(merged, &pose.settings.solve, pose.settings.from_revision);
            chain.and_then(|chain| deformer.solve_for_commit(pose.seq, chain, &pose.settings, &frames, work))
        } else {
            self.solve_drag(deformer, merged, &pose, work)
        };
        Ok(Some(SolvedTurn {
            seq: pose.seq,
            dragged,
            answer,
        }))
    }

    /// A pose, with what it goes on from.
    fn chain(
        &self,
        poses: HandlePoses,
        settings: &SolveSettings,
        from: Option<u64>,
    ) -> Result<PoseChain, engine::Error> {
        let starts = from.and_then(|from| self.starts.get(&from));
        let starts = starts.cloned().unwrap_or_else(|| Ok(Vec::new()))?;
        Ok(PoseChain::of(starts, poses, *settings))
    }

    /// Solves a pose that is dragged. It starts from the last result, takes the best one in time, sends intermediate frames
    /// where they are wanted, and ends early when a newer pose waits.
    fn solve_drag(
        &self,
        deformer: &mut LoadedDeformer,
        poses: HandlePoses,
        pose: &WaitingPose,
        work: &Work<'_>,
    ) -> Result<PoseAnswer, engine::Error> {
        let (settings, watch) = (pose.settings.as_ref(), work.watch);
        let shader = (settings.output.normals || settings.output.tangents).then(|| deformer.shader());
        let asked = settings.budget_ms.map_or(self.longest, |ms| {
            Duration::try_from_secs_f64(ms / 1e3).unwrap_or(self.longest)
        });
        let budget = asked.min(self.longest);
        let (mode, refine) = match settings.fits_coarse_first {
            true => (SolveMode::Anew, COMMIT_REFINE),
            false => (SolveMode::Drag, 0),
        };
        // A drag goes on from the frame before.
        let from = settings.from_revision.filter(|_| settings.fits_coarse_first);
        let chain = self.chain(poses, &settings.solve, from)?;
        let refine = settings.solve.quality.refine.unwrap_or(refine);
        let mut on_cycle = |now: &SolveUpdate<'_>| {
            // Refinement goes on from frame to frame, so a newer pose loses nothing by cutting it short.
            let refining = now.refined > 0 && mode == SolveMode::Drag;
            let has_newer = || self.mailbox.has_newer_pose();
            if watch.elapsed() >= budget || ((settings.progressive || refining) && has_newer()) {
                return false;
            }
            let is_unfinished = !is_good_enough(now, &settings.solve.quality) || now.refined < refine;
            if settings.progressive && is_unfinished && self.mailbox.wants_intermediate_frame() {
                let positions = Arc::new((now.positions)());
                let shading = shader.as_ref().map(|s| Arc::new(s.shade(&positions)));
                let mut frame = self.frames.frame(pose.seq, settings.output, positions, shading);
                frame.header.residual = now.residual;
                frame.header.max_error = now.max_error;
                frame.header.solve_ms = ms_of(watch.elapsed());
                self.mailbox.send_frame(frame);
            }
            true
        };
        let solved = deformer.solve(&chain, mode, &work.exec(), &mut on_cycle)?;
        let solve_time = watch.elapsed();
        let mut frame = deformer.last_frame(pose.seq, settings, &self.frames, &solved);
        frame.header.solve_ms = ms_of(solve_time);
        Ok(PoseAnswer {
            frame,
            cycles: solved.stats.cycles,
            commit: None,
        })
    }
}

/// The pose of a handle with all its targets, as it is in `poses`, where it changes any.
fn with_whole_targets(state: &SessionState, poses: &HandlePoses, id: String, pose: HandlePose) -> (String, HandlePose) {
    let at = (pose.targets.as_ref()).and_then(|_| state.handles.set.handles.iter().position(|h| h.id == id));
    let whole = at.and_then(|at| poses.0.get(at)).cloned();
    (id, whole.unwrap_or(pose))
}

/// What a pose changes, and `poses` with these changes. Of one that stands for several, only the entries that are wrong
/// are left out.
fn valid_changes(
    engine: &dyn Engine,
    poses: &HandlePoses,
    entries: PoseEntries,
    is_merged: bool,
) -> Result<(Vec<(String, HandlePose)>, HandlePoses), Error> {
    let (mut changes, mut wrong) = (Vec::with_capacity(entries.len()), None);
    for (id, pose) in entries {
        match pose {
            Ok(pose) => changes.push((id, pose)),
            Err(error) => wrong = wrong.or(Some(error)),
        }
    }
    let error = match wrong {
        Some(error) => Error::from(error),
        None => match engine.change_poses(poses, &changes) {
            Ok(changed) => return Ok((changes, changed)),
            Err(error) => Error::from(error),
        },
    };
    changes.retain(|change| is_merged && engine.change_poses(poses, std::slice::from_ref(change)).is_ok());
    if changes.is_empty() {
        return Err(error);
    }
    let changed = engine.change_poses(poses, &changes)?;
    Ok((changes, changed))
}

/// Whether a state is good enough, so that the final frame follows at once.
fn is_good_enough(now: &SolveUpdate<'_>, quality: &Quality) -> bool {
    quality.tolerance.is_some_and(|t| now.residual <= t) || quality.max_error.is_some_and(|e| now.max_error <= e)
}
