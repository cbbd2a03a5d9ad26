//! One turn of a deform stream: the waiting poses are checked and merged, the newest is solved, its frame goes out.

use super::Error;
use super::actor::{Actor, no_handles};
use super::bench::Bench;
use super::commits::State;
use super::mailbox::{Done, Mailbox, Work};
use super::outgoing::Outgoing;
use super::stop::Stop;
use super::waiting::{Overlay, Waiting};
use crate::engine::{HandlePoses, SolveMode, SolveSettings, SolveUpdate, SolvedShape};
use crate::engine::{Shading, digest};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::wire;
use crate::wire::{DeformOptions, pb};
use glam::DVec3;
use std::sync::Arc;
use std::time::Duration;

/// What a turn came to.
struct Turn {
    overlay: Overlay,
    solved: Option<Target>,
}

/// The pose that was solved.
struct Target {
    seq: u64,
    commit: bool,
    settings: Arc<DeformOptions>,
    result: Result<Solution, wire::Error>,
}

struct Solution {
    poses: HandlePoses,
    solved: SolvedShape,
    shading: Option<Arc<Shading>>,
    /// Of a commit.
    digest: String,
    /// Of a commit.
    quality: Option<pb::Quality>,
    solve: Duration,
}

/// What every frame of a turn has in common.
struct Frames {
    revision: u64,
    diagonal: f64,
    queued: Duration,
}

impl Frames {
    fn frame(
        &self,
        seq: u64,
        settings: &DeformOptions,
        (residual, max_error): (f64, f64),
        positions: Arc<Vec<DVec3>>,
        shading: Option<Arc<Shading>>,
        solve: Duration,
    ) -> Outgoing {
        let header = pb::Frame {
            seq,
            revision: self.revision,
            residual,
            max_error,
            solve_ms: solve.as_secs_f64() * 1e3,
            queue_ms: self.queued.as_secs_f64() * 1e3,
            ..Default::default()
        };
        Outgoing {
            header,
            positions,
            shading,
            output: settings.output,
            diagonal: self.diagonal,
        }
    }
}

impl Actor {
    /// Serves one stream once.
    pub async fn deform(&mut self, mailbox: Arc<Mailbox>, work: Work) {
        let state = self.history.current().clone();
        let Work { poses, overlay } = work;
        let before = overlay.clone();
        if state.handles.handles.is_empty() {
            return self.refuse_all(&mailbox, &poses, before, &no_handles());
        }
        let seqs: Vec<Waiting> = poses
            .iter()
            .map(|p| Waiting {
                entries: Vec::new(),
                ..p.clone()
            })
            .collect();
        let commit = poses.last().is_some_and(|p| p.commit);
        let longest = self.shared.config.solve;
        // A drag takes its best result in time; only one that has none after twice the time is given up.
        let limit = if commit { longest } else { longest.saturating_mul(2) };
        let (revision, diagonal) = (self.history.revision(), state.diagonal);
        let desk = Arc::clone(&mailbox);
        let ran = self
            .compute(&mailbox.cancel, limit, move |bench, pool, stop, queued| {
                let frames = Frames {
                    revision,
                    diagonal,
                    queued,
                };
                let turn = turn(bench, pool, stop, &desk, poses, overlay, &state, &frames, longest);
                (turn, frames)
            })
            .await;
        let ((turn, mut frames), stop) = match ran {
            Ok(ran) => ran,
            Err(error) => return self.refuse_all(&mailbox, &seqs, before, &error),
        };
        let turn = match turn {
            Ok(turn) => turn,
            Err(error) => return self.refuse_all(&mailbox, &seqs, before, &self.failure(error, &stop)),
        };
        let Some(Target {
            seq,
            commit,
            settings,
            result,
        }) = turn.solved
        else {
            return mailbox.complete(Done {
                overlay: turn.overlay,
                ..Done::default()
            });
        };
        let Solution {
            poses,
            solved,
            shading,
            digest,
            quality,
            solve,
        } = match result {
            Ok(solution) => solution,
            Err(error) => {
                let refused = Some((seq, self.failure(error, &stop)));
                return mailbox.complete(Done {
                    overlay: before,
                    refused,
                    ..Done::default()
                });
            }
        };
        let metrics = &self.shared.metrics;
        metrics.solve.observe(solve.as_secs_f64());
        metrics.cycles.inc_by(solved.cycles.into());
        metrics.poses_solved.inc();
        let mut overlay = turn.overlay;
        if commit {
            metrics.commits.inc();
            let kept = settings.solve.clone();
            self.history
                .commit_pose(poses, kept, Arc::clone(&solved.positions), digest);
            self.publish();
            // What was dragged is in the commit now.
            overlay.clear();
            frames.revision = self.history.revision();
        }
        let errors = (solved.residual, solved.max_error);
        let mut frame = frames.frame(seq, &settings, errors, solved.positions, shading, solve);
        frame.header.r#final = true;
        frame.header.quality = quality;
        mailbox.complete(Done {
            overlay,
            frame: Some(frame),
            refused: None,
        });
    }

    fn refuse_all(&self, mailbox: &Mailbox, poses: &[Waiting], overlay: Overlay, error: &Error) {
        let merged = poses.iter().map(|p| p.poses - 1).sum();
        mailbox.settle(poses.iter().map(|p| (p.seq, error.clone())).collect(), merged);
        mailbox.complete(Done {
            overlay,
            ..Done::default()
        });
    }
}

/// Checks and merges `poses` on top of what is in force, then solves the newest one that is right.
fn turn(
    bench: &mut Bench,
    pool: &Pool,
    stop: &Stop,
    mailbox: &Mailbox,
    poses: Vec<Waiting>,
    mut overlay: Overlay,
    state: &State,
    frames: &Frames,
    longest: Duration,
) -> Result<Turn, wire::Error> {
    bench.load(state.trail.as_ref(), &state.handles, &Exec::new(pool, stop))?;
    let mut refused = Vec::new();
    let mut superseded = 0u32;
    let mut newest: Option<Waiting> = None;
    for mut pose in poses {
        let others = pose.poses.saturating_sub(1);
        match check(bench, state, &mut pose) {
            Ok(()) => {
                overlay.extend(std::mem::take(&mut pose.entries).into_iter().map(|e| (e.id, e.pose)));
                let skipped = newest.replace(pose).map_or(0, |_| 1);
                superseded = superseded.saturating_add(skipped);
            }
            Err(error) => refused.push((pose.seq, error.into())),
        }
        superseded = superseded.saturating_add(others);
    }
    mailbox.settle(refused, superseded);
    let Some(Waiting {
        seq, commit, settings, ..
    }) = newest
    else {
        return Ok(Turn { overlay, solved: None });
    };
    let result = solve(
        bench,
        pool,
        stop,
        mailbox,
        (seq, commit, &settings),
        &overlay,
        state,
        frames,
        longest,
    );
    Ok(Turn {
        overlay,
        solved: Some(Target {
            seq,
            commit,
            settings,
            result,
        }),
    })
}

/// Checks a pose. Of one that stands for several, only what is wrong is left out.
fn check(bench: &Bench, state: &State, pose: &mut Waiting) -> Result<(), wire::Error> {
    let entries = std::mem::take(&mut pose.entries);
    let whole = pb::Pose {
        handles: entries,
        ..Default::default()
    };
    let error = match bench.engine.posed(&state.poses, &whole) {
        Ok(_) => {
            pose.entries = whole.handles;
            return Ok(());
        }
        Err(error) => error,
    };
    if pose.poses > 1 {
        let right = |entry: &pb::pose::Entry| {
            let alone = pb::Pose {
                handles: vec![entry.clone()],
                ..Default::default()
            };
            bench.engine.posed(&state.poses, &alone).is_ok()
        };
        pose.entries = whole.handles.into_iter().filter(right).collect();
    }
    if pose.entries.is_empty() { Err(error) } else { Ok(()) }
}

fn solve(
    bench: &mut Bench,
    pool: &Pool,
    stop: &Stop,
    mailbox: &Mailbox,
    (seq, commit, settings): (u64, bool, &Arc<DeformOptions>),
    overlay: &Overlay,
    state: &State,
    frames: &Frames,
    longest: Duration,
) -> Result<Solution, wire::Error> {
    let entries = overlay.iter().map(|(id, pose)| pb::pose::Entry {
        id: id.clone(),
        pose: pose.clone(),
    });
    let change = pb::Pose {
        handles: entries.collect(),
        ..Default::default()
    };
    let poses = bench.engine.posed(&state.poses, &change)?;
    let shader = (settings.output.normals || settings.output.tangents).then(|| bench.shader());
    let shade = |positions: &[DVec3]| shader.as_ref().map(|s| Arc::new(s.shade(positions)));
    let asked = settings
        .budget_ms
        .map_or(longest, |ms| Duration::try_from_secs_f64(ms / 1e3).unwrap_or(longest));
    let budget = asked.min(longest);
    let mut watch = |now: &SolveUpdate<'_>| {
        if commit {
            return true;
        }
        // Refinement goes on from frame to frame, so a newer pose loses nothing by cutting it short.
        let refining = now.refined > 0;
        if stop.elapsed() >= budget || ((settings.progressive || refining) && mailbox.newer()) {
            return false;
        }
        let unfinished = !reached(now, settings) || now.refined < settings.solve.refine.unwrap_or(0);
        if settings.progressive && unfinished && mailbox.wants_more() {
            let positions = Arc::new((now.positions)());
            let shading = shade(&positions);
            let errors = (now.residual, now.max_error);
            mailbox.send(frames.frame(seq, settings, errors, positions, shading, stop.elapsed()));
        }
        true
    };
    let mode = if commit { SolveMode::Commit } else { SolveMode::Drag };
    let solved = bench.solve(&poses, &settings.solve, mode, &Exec::new(pool, stop), &mut watch)?;
    let solve = stop.elapsed();
    let shading = shade(&solved.positions);
    let (digest, quality) = if commit {
        let quality = bench
            .engine
            .measure(&solved.positions, &settings.output, &Exec::new(pool, stop))?;
        (digest(&solved.positions), quality)
    } else {
        (String::new(), None)
    };
    Ok(Solution {
        poses,
        solved,
        shading,
        digest,
        quality,
        solve,
    })
}

/// Whether a state is good enough, so that the final frame follows at once.
fn reached(now: &SolveUpdate<'_>, settings: &DeformOptions) -> bool {
    let SolveSettings {
        tolerance, max_error, ..
    } = &settings.solve;
    tolerance.is_some_and(|t| now.residual <= t) || max_error.is_some_and(|e| now.max_error <= e)
}
