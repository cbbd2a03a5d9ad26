//! One turn of a deform stream: the waiting poses are checked and merged, the newest is solved, its frame goes out.

use crate::engine::{self, HandlePose, SolveMode, SolveSettings, SolveUpdate, TopologyState};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::session::answers::CommittedPose;
use crate::session::calls::command::{StoredAnswer, WorkOrder};
use crate::session::calls::idempotency::{ClaimOutcome, KeyClaim};
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::WorkKind;
use crate::session::capacity::work_watch::WorkWatch;
use crate::session::error::Error;
use crate::session::history::loaded_deformer::{CommitSolution, LoadedDeformer};
use crate::session::history::session_state::SessionState;
use crate::session::stream::mailbox::{Mailbox, StreamWork, StreamWorkResult};
use crate::session::stream::outbound_frame::{FrameContext, FrameShape, OutboundFrame};
use crate::session::stream::waiting_poses::{DraggedPoses, WaitingPose};
use crate::session::task::commands::lane_of_commit;
use crate::session::task::session_task::{SessionTask, no_handles};
use crate::wire::record::AnsweredFrame;
use crate::wire::{DeformOptions, Error as WireError, PoseEntry};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What a turn came to.
struct StreamTurn {
    dragged: DraggedPoses,
    solved: Option<SolvedStreamPose>,
}

/// The pose that was solved, or why it was not.
struct SolvedStreamPose {
    seq: u64,
    commit: bool,
    settings: Arc<DeformOptions>,
    result: Result<CommitSolution, engine::Error>,
}

/// What a turn works with on a compute thread.
struct TurnContext {
    mailbox: Arc<Mailbox>,
    state: SessionState,
    frames: FrameContext,
    /// The longest solve.
    longest: Duration,
}

impl SessionTask {
    /// Serves one stream once.
    pub async fn serve_stream(&mut self, mailbox: Arc<Mailbox>, work: StreamWork) {
        let state = self.history.current().clone();
        let StreamWork { poses, dragged } = work;
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
        let (revision, desk) = (self.history.revision(), Arc::clone(&mailbox));
        let order = WorkOrder {
            lane,
            ..turn_order(&mailbox, commit, limit)
        };
        let ran = self
            .compute(order, move |deformer, pool, watch, queued| {
                let frames = FrameContext {
                    revision,
                    topology: state.topology.as_ref().map(TopologyState::id),
                    diagonal: state.diagonal,
                    queued,
                };
                let turn = TurnContext {
                    mailbox: desk,
                    state,
                    frames,
                    longest,
                };
                let result = turn.solve_newest(deformer, pool, watch, poses, dragged);
                (result, turn.frames)
            })
            .await;
        let ((turn, mut frames), watch) = match ran {
            Ok(ran) => ran,
            Err(error) => return refuse_all(&mailbox, &unsolved, before, &error),
        };
        let turn = match turn {
            Ok(turn) => turn,
            Err(error) => return refuse_all(&mailbox, &unsolved, before, &self.failure(error, &watch)),
        };
        let Some(SolvedStreamPose {
            seq,
            commit,
            settings,
            result,
        }) = turn.solved
        else {
            return mailbox.complete_work(StreamWorkResult {
                dragged: turn.dragged,
                ..StreamWorkResult::default()
            });
        };
        let solution = match result {
            Ok(solution) => solution,
            Err(error) => {
                let refused = Some((seq, self.failure(error, &watch)));
                return mailbox.complete_work(StreamWorkResult {
                    dragged: before,
                    refused,
                    ..StreamWorkResult::default()
                });
            }
        };
        if commit {
            frames.revision = self.history.revision() + 1;
            let frame = frames.final_frame(seq, &settings, &solution);
            let (dragged, frame, refused) = match self.record(solution, &settings, &frame, claim).await {
                // What was dragged is in the commit now.
                Ok(()) => (DraggedPoses::new(), Some(frame), None),
                Err(error) => (before, None, Some((seq, error))),
            };
            return mailbox.complete_work(StreamWorkResult {
                dragged,
                frame,
                refused,
            });
        }
        self.count_solve(&solution);
        mailbox.complete_work(StreamWorkResult {
            dragged: turn.dragged,
            frame: Some(frames.final_frame(seq, &settings, &solution)),
            refused: None,
        });
        self.settle_drag(&mailbox).await;
    }

    /// Works ahead once a frame is out, where that has left much undone. Done whether another pose waits by now or not, so that
    /// frames depend on poses and not on time.
    async fn settle_drag(&mut self, mailbox: &Mailbox) {
        let is_needed = |deformer: &LoadedDeformer| deformer.engine.is_worth_settling();
        if !self.deformer.as_ref().is_some_and(is_needed) {
            return;
        }
        let order = WorkOrder {
            kind: WorkKind::Settle,
            ..turn_order(mailbox, false, self.shared.config.solve)
        };
        let ran = self.compute(order, |deformer, pool, watch, _| {
            deformer.engine.settle(&Exec::new(pool, watch))
        });
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
        solution: CommitSolution,
        settings: &DeformOptions,
        frame: &OutboundFrame,
        claim: Option<KeyClaim<StoredAnswer>>,
    ) -> Result<(), Error> {
        let answered = claim.is_some().then(|| AnsweredFrame {
            header: frame.header.clone(),
            output: frame.output,
        });
        self.keep_pose(&solution, &settings.solve, answered, claim.as_ref())
            .await?;
        self.commit_solution(&solution, settings.solve.clone());
        if let Some(claim) = claim {
            let answer = StoredAnswer::Solved(Box::new(CommittedPose {
                frame: frame.clone().into_first_request(self.shared.config.part_bytes),
                revision: self.history.revision(),
                digest: solution.digest,
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
                let others: u32 = poses.iter().map(|p| p.poses).sum();
                mailbox.settle_unsolved(Vec::new(), others.saturating_sub(1));
                mailbox.complete_work(StreamWorkResult {
                    frame: Some(frame),
                    ..StreamWorkResult::default()
                });
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
    mailbox.complete_work(StreamWorkResult {
        dragged,
        ..StreamWorkResult::default()
    });
}

impl TurnContext {
    /// Checks and merges `poses` on top of what is in force, then solves the newest one that is right.
    fn solve_newest(
        &self,
        deformer: &mut LoadedDeformer,
        pool: &Pool,
        watch: &WorkWatch,
        poses: Vec<WaitingPose>,
        mut dragged: DraggedPoses,
    ) -> Result<StreamTurn, engine::Error> {
        let state = &self.state;
        deformer.load_state(state.topology.as_ref(), &state.handles, &Exec::new(pool, watch))?;
        let mut refused = Vec::new();
        let mut superseded = 0u32;
        let mut newest: Option<WaitingPose> = None;
        for mut pose in poses {
            let others = pose.poses.saturating_sub(1);
            match self.take_valid_changes(deformer, &mut pose) {
                Ok(changes) => {
                    dragged.extend(changes);
                    let skipped = newest.replace(pose).map_or(0, |_| 1);
                    superseded = superseded.saturating_add(skipped);
                }
                Err(error) => refused.push((pose.seq, error)),
            }
            superseded = superseded.saturating_add(others);
        }
        self.mailbox.settle_unsolved(refused, superseded);
        let Some(pose) = newest else {
            return Ok(StreamTurn { dragged, solved: None });
        };
        let changes: Vec<_> = dragged.iter().map(|(id, pose)| (id.clone(), *pose)).collect();
        let result = if pose.commit {
            deformer.solve_for_commit(state, &changes, &pose.settings, watch, pool)
        } else {
            self.solve_drag(deformer, &changes, &pose, watch, pool)
        };
        let solved = Some(SolvedStreamPose {
            seq: pose.seq,
            commit: pose.commit,
            settings: pose.settings,
            result,
        });
        Ok(StreamTurn { dragged, solved })
    }

    /// Checks a pose and returns what it changes. Of one that stands for several, only the entries that are wrong are left
    /// out.
    fn take_valid_changes(
        &self,
        deformer: &LoadedDeformer,
        pose: &mut WaitingPose,
    ) -> Result<Vec<(String, HandlePose)>, Error> {
        let check = |changes: Vec<(String, HandlePose)>| match deformer.engine.change_poses(&self.state.poses, &changes)
        {
            Ok(_) => Ok(changes),
            Err(error) => Err(Error::from(error)),
        };
        let entries = std::mem::take(&mut pose.entries);
        let whole: Result<Vec<_>, WireError> = entries.iter().cloned().map(PoseEntry::into_change).collect();
        let error = match whole.map_err(Error::from).and_then(check) {
            Ok(changes) => return Ok(changes),
            Err(error) => error,
        };
        let mut right = Vec::new();
        if pose.poses > 1 {
            let alone = entries.into_iter().filter_map(|e| e.into_change().ok());
            right.extend(alone.filter_map(|change| check(vec![change]).ok()).flatten());
        }
        if right.is_empty() { Err(error) } else { Ok(right) }
    }

    /// Solves a pose that is dragged. It starts from the last result, takes the best one in time, sends intermediate frames
    /// where they are wanted, and ends early when a newer pose waits.
    fn solve_drag(
        &self,
        deformer: &mut LoadedDeformer,
        changes: &[(String, HandlePose)],
        pose: &WaitingPose,
        watch: &WorkWatch,
        pool: &Pool,
    ) -> Result<CommitSolution, engine::Error> {
        let settings = pose.settings.as_ref();
        let poses = deformer.engine.change_poses(&self.state.poses, changes)?;
        let shader = (settings.output.normals || settings.output.tangents).then(|| deformer.shader());
        let asked = settings.budget_ms.map_or(self.longest, |ms| {
            Duration::try_from_secs_f64(ms / 1e3).unwrap_or(self.longest)
        });
        let budget = asked.min(self.longest);
        let mut on_cycle = |now: &SolveUpdate<'_>| {
            // Refinement goes on from frame to frame, so a newer pose loses nothing by cutting it short.
            let refining = now.refined > 0;
            let has_newer = || self.mailbox.has_newer_pose();
            if watch.elapsed() >= budget || ((settings.progressive || refining) && has_newer()) {
                return false;
            }
            let is_unfinished =
                !is_good_enough(now, &settings.solve) || now.refined < settings.solve.refine.unwrap_or(0);
            if settings.progressive && is_unfinished && self.mailbox.wants_intermediate_frame() {
                let positions = Arc::new((now.positions)());
                let shading = shader.as_ref().map(|s| Arc::new(s.shade(&positions)));
                let shape = FrameShape {
                    positions,
                    shading,
                    residual: now.residual,
                    max_error: now.max_error,
                };
                let frame = (self.frames).build_frame(pose.seq, settings.output, shape, watch.elapsed());
                self.mailbox.send_frame(frame);
            }
            true
        };
        let exec = Exec::new(pool, watch);
        let solved = deformer.solve(&poses, &settings.solve, SolveMode::Drag, &exec, &mut on_cycle)?;
        let solve_time = watch.elapsed();
        Ok(CommitSolution {
            poses,
            shading: deformer.shade(&solved.positions, settings),
            digest: String::new(),
            quality: None,
            warnings: Vec::new(),
            solve_time,
            solved,
        })
    }
}

/// Whether a state is good enough, so that the final frame follows at once.
fn is_good_enough(now: &SolveUpdate<'_>, settings: &SolveSettings) -> bool {
    settings.tolerance.is_some_and(|t| now.residual <= t) || settings.max_error.is_some_and(|e| now.max_error <= e)
}
