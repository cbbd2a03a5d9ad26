//! The task that owns one session: the only one that touches its engine and its commits.
//!
//! Commands and streams take turns, streams among themselves too. State changes here only, after the work for it has
//! succeeded, so a call that fails or is given up leaves everything as it was. While work runs on the compute pool the
//! engine is there too; everything that others read meanwhile is in the session's published view.

use super::bench::Bench;
use super::budget::Reservation;
use super::commits::History;
use super::compute::Panicked;
use super::mailbox::{Mailbox, Work};
use super::manager::Shared;
use super::registry::{Session, View};
use super::requests::{Call, Change, Command, Direction, Stored};
use super::stop::Stop;
use super::{Code, Error, Exported, SolvedFrames};
use crate::asset::Format;
use crate::engine::SolveMode;
use crate::engine::digest;
use crate::exec::Exec;
use crate::pool::Pool;
use crate::progress::{CancelFlag, Progress as _};
use crate::wire;
use crate::wire::frames::{FrameRequest, encode};
use crate::wire::{DeformOptions, pb};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, mpsc};

/// The state of one session and its task.
pub(super) struct Actor {
    pub session: Arc<Session>,
    pub shared: Arc<Shared>,
    pub commands: mpsc::Receiver<Command>,
    /// Away while work runs; gone for good after a panic.
    pub bench: Option<Bench>,
    pub history: History,
    pub build_ms: BTreeMap<String, f64>,
    pub memory: Reservation,
    pub seat: OwnedSemaphorePermit,
    /// Which stream is asked for work first.
    pub turn: usize,
}

impl Actor {
    /// Serves the session until it is closed or expires.
    pub async fn run(mut self) {
        let session = Arc::clone(&self.session);
        while !session.closing.is_cancelled() {
            let mut worked = false;
            if let Ok(command) = self.commands.try_recv() {
                self.serve(command).await;
                worked = true;
            }
            if let Some((mailbox, work)) = self.next_work() {
                self.deform(mailbox, work).await;
                worked = true;
            }
            if worked {
                // Work may have taken longer than the lease.
                session.lease.renew();
                continue;
            }
            tokio::select! {
                () = session.closing.cancelled() => {}
                Some(command) = self.commands.recv() => {
                    self.serve(command).await;
                    session.lease.renew();
                }
                () = session.wake.notified() => {}
                () = tokio::time::sleep_until(session.lease.end()) => {
                    if !session.streams.all().is_empty() {
                        session.lease.renew();
                    } else if session.lease.expired() {
                        self.shared.metrics.sessions_expired.inc();
                        tracing::info!(session.id = %session.id, "session expired");
                        session.close(Error::no_session(&session.id));
                    }
                }
            }
        }
        self.end();
    }

    fn end(self) {
        let Self {
            session,
            shared,
            commands,
            bench,
            history,
            memory,
            seat,
            ..
        } = self;
        session.close(Error::no_session(&session.id));
        shared.registry.remove(&session.id);
        shared.metrics.sessions.dec();
        // Whoever waits for an answer learns of the end by this.
        drop(commands);
        // Dropped where it holds nobody up, in this order: what is told last is that memory and seat are free.
        shared
            .compute
            .discard((bench, history, memory, seat, session.ended.clone().drop_guard()));
    }

    /// Work of the next stream that has some.
    fn next_work(&mut self) -> Option<(Arc<Mailbox>, Work)> {
        let streams = self.session.streams.all();
        for k in 0..streams.len() {
            let at = (self.turn + k) % streams.len();
            if let Some(work) = streams[at].take() {
                self.turn = at + 1;
                return Some((Arc::clone(&streams[at]), work));
            }
        }
        None
    }

    /// Runs work on the compute pool with the engine. The flags and `limit` stop it.
    pub async fn compute<R: Send + 'static>(
        &mut self,
        flag: &Arc<CancelFlag>,
        limit: Duration,
        work: impl FnOnce(&mut Bench, &Pool, &Stop, Duration) -> R + Send + 'static,
    ) -> Result<(R, Arc<Stop>), Error> {
        let slot = tokio::select! {
            biased;
            () = self.session.closing.cancelled() => return Err(self.session.why()),
            slot = self.shared.compute.slot() => slot?,
        };
        let lost = || Error::new(Code::Internal, "the session's engine is gone");
        let mut bench = self.bench.take().ok_or_else(lost)?;
        let stop = Arc::new(Stop::new(
            vec![Arc::clone(flag), Arc::clone(&self.session.cancel)],
            limit,
        ));
        let (watch, queued) = (Arc::clone(&stop), slot.queued);
        let ran = slot.run(move |pool| {
            let value = work(&mut bench, pool, &watch, queued);
            (bench, value)
        });
        match ran.await {
            Ok((bench, value)) => {
                self.memory.resize(bench.bytes().saturating_add(self.history.bytes()));
                self.bench = Some(bench);
                Ok((value, stop))
            }
            Err(Panicked(text)) => {
                self.shared.metrics.sessions_failed.inc();
                tracing::error!(session.id = %self.session.id, panic = text, "work panicked; the session is closed");
                let error = Error::from(Panicked(text));
                self.session.close(Error {
                    message: format!("{error}; the session is closed"),
                    ..error
                });
                Err(self.session.why())
            }
        }
    }

    /// What the failure of a piece of work means to its caller.
    pub fn failure(&self, error: wire::Error, stop: &Stop) -> Error {
        if error != wire::Error::Cancelled {
            return error.into();
        }
        self.shared.metrics.cancelled.inc();
        if self.session.cancel.cancelled() {
            self.session.why()
        } else if stop.abandoned() {
            Error::new(Code::Cancelled, "the caller gave up")
        } else {
            let text = format!(
                "took longer than the {} ms that are allowed; nothing has changed",
                stop.limit().as_millis()
            );
            Error::new(Code::DeadlineExceeded, text)
        }
    }

    /// Shows the state to everybody.
    pub fn publish(&mut self) {
        let state = self.history.current();
        // The current shape is always at hand; `go` and the commits see to it.
        let positions = self.history.shape(state.shape).unwrap_or_default();
        let view = View {
            revision: self.history.revision(),
            facts: Arc::clone(&state.facts),
            poses: state.poses.clone(),
            build_ms: self.build_ms.clone(),
            positions,
            digest: state.digest.clone(),
            history: self.history.describe(),
        };
        self.session.publish(view);
        let engine = self.bench.as_ref().map_or(0, Bench::bytes);
        self.memory.resize(engine.saturating_add(self.history.bytes()));
    }

    async fn serve(&mut self, command: Command) {
        match command {
            Command::SetHandles(change, call) => {
                let result = self.set_handles(change, &call).await;
                answer(call, result, |session| Some(Stored::Session(Box::new(session.clone()))));
            }
            Command::Step(direction, call) => {
                let result = self.step(direction, &call).await;
                answer(call, result, |session| Some(Stored::Session(Box::new(session.clone()))));
            }
            Command::Solve(request, call) => {
                let (pose, settings) = *request;
                let (result, stored) = match self.solve(pose, settings, &call).await {
                    Ok((solved, stored)) => (Ok(solved), Some(stored)),
                    Err(error) => (Err(error), None),
                };
                answer(call, result, |_| stored);
            }
            Command::Edit(request, call) => {
                let result = self.edit(*request, &call).await;
                answer(call, result, |result| Some(Stored::Edited(Box::new(result.clone()))));
            }
            Command::Export(format, call) => {
                let result = self.export(format, &call).await;
                answer(call, result, |_| None);
            }
        }
    }

    async fn set_handles(&mut self, change: Change, call: &Call<pb::Session>) -> Result<pb::Session, Error> {
        let state = self.history.current();
        let request = change.apply(&state.handles, &state.poses)?;
        let limit = self.shared.config.build;
        let trail = state.trail.clone();
        let (replaced, stop) = self
            .compute(&call.cancel, limit, move |bench, pool, stop, _| {
                let replaced = bench.replace(trail.as_ref(), &request, &Exec::new(pool, stop));
                (replaced, request, stop.take_stage_ms())
            })
            .await?;
        let (replaced, request, stages) = replaced;
        let (poses, facts) = replaced.map_err(|e| self.failure(e, &stop))?;
        self.build_ms.extend(stages);
        self.history.commit_handles(request, poses, facts);
        if let Some(bench) = &mut self.bench {
            bench.adopt(&self.history.current().handles);
        }
        self.session.streams.all().iter().for_each(|m| m.forget_overlay());
        self.shared.metrics.commits.inc();
        self.publish();
        Ok(self.session.describe())
    }

    async fn solve(
        &mut self,
        pose: pb::Pose,
        settings: DeformOptions,
        call: &Call<SolvedFrames>,
    ) -> Result<(SolvedFrames, Stored), Error> {
        let state = self.history.current().clone();
        if state.handles.handles.is_empty() {
            return Err(no_handles());
        }
        let (limit, part_bytes, diagonal) = (self.shared.config.solve, self.shared.config.part_bytes, state.diagonal);
        let (revision, kept) = (self.history.revision() + 1, settings.clone());
        let (solved, stop) = self
            .compute(
                &call.cancel,
                limit,
                move |bench, pool, stop, queued| -> Result<_, wire::Error> {
                    bench.load(state.trail.as_ref(), &state.handles, &Exec::new(pool, stop))?;
                    let poses = bench.engine.posed(&state.poses, &pose)?;
                    let solved = bench.solve(
                        &poses,
                        &settings,
                        SolveMode::Commit,
                        &Exec::new(pool, stop),
                        &mut |_| true,
                    )?;
                    let elapsed = stop.elapsed();
                    let quality = bench
                        .engine
                        .measure(&solved.positions, &settings.output, &Exec::new(pool, stop))?;
                    let shading = (settings.output.normals || settings.output.tangents)
                        .then(|| Arc::new(bench.shader().shade(&solved.positions)));
                    let frame = FrameRequest {
                        header: pb::Frame {
                            seq: pose.seq,
                            revision,
                            r#final: true,
                            residual: solved.residual,
                            max_error: solved.max_error,
                            solve_ms: elapsed.as_secs_f64() * 1e3,
                            queue_ms: queued.as_secs_f64() * 1e3,
                            quality,
                            ..Default::default()
                        },
                        positions: Arc::clone(&solved.positions),
                        shading,
                        output: settings.output,
                        baselines: Vec::new(),
                        diagonal,
                        part_bytes,
                    };
                    let frames: Vec<pb::Frame> = encode(frame.clone()).collect();
                    Ok((poses, digest(&solved.positions), solved, frames, frame, elapsed))
                },
            )
            .await?;
        let (poses, digest, solved, frames, frame, elapsed) = solved.map_err(|e| self.failure(e, &stop))?;
        self.history
            .commit_pose(poses, kept, Arc::clone(&solved.positions), digest.clone());
        self.publish();
        let metrics = &self.shared.metrics;
        metrics.solve.observe(elapsed.as_secs_f64());
        metrics.cycles.inc_by(solved.cycles.into());
        metrics.poses_solved.inc();
        metrics.commits.inc();
        metrics.frames_sent.inc();
        let stored = Stored::Solved {
            frame: Box::new(frame),
            revision,
            digest: digest.clone(),
        };
        Ok((
            SolvedFrames {
                frames,
                revision,
                positions: solved.positions,
                digest,
            },
            stored,
        ))
    }

    async fn step(&mut self, direction: Direction, call: &Call<pb::Session>) -> Result<pb::Session, Error> {
        let (target, nothing) = match direction {
            Direction::Undo => (self.history.behind(), "nothing is left to undo"),
            Direction::Redo => (self.history.ahead(), "nothing is left to redo"),
        };
        let nothing = || Error::new(Code::FailedPrecondition, nothing);
        let index = target.ok_or_else(nothing)?;
        let shape = self.history.state(index).ok_or_else(nothing)?.shape;
        let positions = match self.history.shape(shape) {
            Ok(positions) => positions,
            Err(recipe) => {
                let limit = self.shared.config.build;
                let replay =
                    move |bench: &mut Bench, pool: &Pool, stop: &Stop, _| bench.replay(&recipe, &Exec::new(pool, stop));
                let (positions, stop) = self.compute(&call.cancel, limit, replay).await?;
                positions.map_err(|e| self.failure(e, &stop))?
            }
        };
        self.history.go(index, positions);
        self.session.streams.all().iter().for_each(|m| m.forget_overlay());
        self.publish();
        Ok(self.session.describe())
    }

    async fn export(&mut self, format: Option<Format>, call: &Call<Exported>) -> Result<Exported, Error> {
        let view = self.session.view();
        let format = format.unwrap_or(self.session.format);
        let etag = Session::etag(&view, format.name());
        let limit = self.shared.config.build;
        let positions = Arc::clone(&view.positions);
        let trail = self.history.current().trail.clone();
        let (written, stop) = self
            .compute(&call.cancel, limit, move |bench, pool, stop, _| {
                bench.go(trail.as_ref(), &Exec::new(pool, stop))?;
                bench.engine.write(&positions, format)
            })
            .await?;
        Ok(Exported {
            written: written.map_err(|e| self.failure(e, &stop))?,
            format,
            etag,
        })
    }
}

fn answer<T>(call: Call<T>, result: Result<T, Error>, store: impl FnOnce(&T) -> Option<Stored>) {
    let Call { reply, claim, .. } = call;
    if let (Some(claim), Ok(value)) = (claim, &result)
        && let Some(stored) = store(value)
    {
        let bytes = stored.bytes();
        claim.complete(stored, bytes);
    }
    // The caller may have gone; the change stands.
    let _ = reply.send(result);
}

/// Deforming needs handles.
pub(super) fn no_handles() -> Error {
    Error::new(
        Code::FailedPrecondition,
        "no handles are set; set them before deforming",
    )
}
