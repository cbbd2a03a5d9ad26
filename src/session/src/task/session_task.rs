//! The task that owns one session: the only one that touches its engine and its commits.
//!
//! Commands and streams take turns, streams among themselves too. State changes here only, after the work for it has
//! succeeded, so a call that fails or is given up leaves everything as it was. While work runs on the compute pool the
//! engine is there too; everything that others read meanwhile is in the session's published view.
//!
//! An unused session leaves memory: first what is derived and quickly rebuilt, later all of it.

use crate::audit::audit_entry::{AuditEntry, AuditedAction};
use crate::calls::command::{SessionCommand, StoredAnswer, WorkOrder};
use crate::calls::idempotency::KeyClaim;
use crate::capacity::compute_slots::WorkPanicked;
use crate::capacity::memory_ledger::MemoryReservation;
use crate::capacity::work_watch::{Work, WorkSpan, WorkWatch};
use crate::error::{Error, ErrorCode};
use crate::history::commit_history::CommitHistory;
use crate::history::loaded_deformer::LoadedDeformer;
use crate::history::session_state::{PosedState, SessionState};
use crate::keeping::kept_session::{KeptSession, MemoryState};
use crate::quota::tenant_account::TenantSession;
use crate::registry::{OpenSession, SessionView};
use crate::shared::SharedResources;
use crate::stream::mailbox::Mailbox;
use crate::stream::waiting_poses::WaitingPose;
use crate::task::adopted_parts::AdoptedParts;
use pliant_core::engine;
use pliant_exec::progress::Progress as _;
use pliant_wire::frames::Frame;
use pliant_wire::pb;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio::time::Instant;

/// The state of one session and its task.
pub(crate) struct SessionTask {
    pub session: Arc<OpenSession>,
    pub shared: Arc<SharedResources>,
    pub commands: mpsc::Receiver<SessionCommand>,
    /// Away while work runs; gone for good after a panic.
    pub deformer: Option<LoadedDeformer>,
    pub history: CommitHistory,
    pub build_ms: BTreeMap<String, f64>,
    pub memory: Arc<MemoryReservation>,
    /// The place among those of its tenant.
    pub place: TenantSession,
    pub session_permit: OwnedSemaphorePermit,
    /// Which stream is asked for work first.
    pub next_stream: usize,
    /// What is known of the log in the store, if the session is kept.
    pub kept: Option<KeptSession>,
    pub memory_state: MemoryState,
    /// The parts of a shape to adopt that have come so far.
    pub adopted_parts: Option<AdoptedParts>,
    /// The caller of the work under way, for the audit trail.
    pub acting: Arc<str>,
}

impl SessionTask {
    /// Serves the session until it is closed or expires.
    pub async fn run(mut self) {
        let session = Arc::clone(&self.session);
        while !session.closing.is_cancelled() {
            let mut worked = false;
            if let Ok(command) = self.commands.try_recv() {
                session.busy.store(true, SeqCst);
                self.serve_command(command).await;
                worked = true;
            }
            if let Some((mailbox, work)) = self.next_stream_work() {
                self.serve_stream(mailbox, work).await;
                worked = true;
            }
            if worked {
                // Work may have taken longer than the lease.
                self.finish_work();
                continue;
            }
            session.busy.store(false, SeqCst);
            if self.evict().await {
                break;
            }
            let evict = self.next_eviction();
            tokio::select! {
                biased;
                () = session.closing.cancelled() => {}
                Some(command) = self.commands.recv() => {
                    session.busy.store(true, SeqCst);
                    self.serve_command(command).await;
                    self.finish_work();
                }
                () = session.wake.notified() => {}
                () = tokio::time::sleep_until(evict.unwrap_or_else(|| session.lease.end())), if evict.is_some() => {}
                () = tokio::time::sleep_until(session.lease.end()) => {
                    if !session.streams.all().is_empty() || session.animations.is_any() {
                        session.lease.renew();
                    } else if session.lease.expired() {
                        self.expire().await;
                    }
                }
            }
        }
        self.end();
    }

    /// After work: the session was used, and is whole again.
    fn finish_work(&mut self) {
        self.session.lease.renew();
        self.memory_state = MemoryState::Full;
        self.keep_shape_in_time();
    }

    /// Ends the expired session. If its store does not answer, it is deleted there later.
    async fn expire(&mut self) {
        let id = self.session.id.clone();
        let shared = Arc::clone(&self.shared);
        let lock = shared.locks.lock(&id).await;
        self.session.close(Error::no_session(&id));
        shared.registry.remove(&id);
        if let Some(store) = &shared.store {
            match store.delete(self.expiry(), self.session.held.generation).await {
                Ok(()) => self.place.account().uncount_session(),
                Err(error) => tracing::warn!(session.id = %id, "an expired session is still in the store: {error}"),
            }
        }
        if shared.store.is_none() {
            self.expiry().log();
        }
        drop(lock);
        shared.metrics.sessions_expired.inc();
        tracing::info!(session.id = %id, "session expired");
    }

    fn expiry(&self) -> AuditEntry {
        AuditEntry::by_itself(&self.session.tenant, AuditedAction::Expire, &self.session.id)
    }

    fn end(self) {
        let Self {
            session,
            shared,
            commands,
            deformer,
            history,
            memory,
            place,
            session_permit,
            ..
        } = self;
        session.close(Error::no_session(&session.id));
        shared.registry.remove_this(&session);
        shared.metrics.sessions.dec();
        // A caller that waits for an answer learns of the end by this.
        drop(commands);
        // Dropped where it delays no caller, in this order: the end is announced last, when memory and permit are free.
        shared.compute.discard((
            deformer,
            history,
            memory,
            place,
            session_permit,
            session.ended.clone().drop_guard(),
        ));
    }

    /// Work of the next stream that has some.
    fn next_stream_work(&mut self) -> Option<(Arc<Mailbox>, Vec<WaitingPose>)> {
        let streams = self.session.streams.all();
        for k in 0..streams.len() {
            let at = (self.next_stream + k) % streams.len();
            if let Some(poses) = streams[at].take_work() {
                self.next_stream = at + 1;
                return Some((Arc::clone(&streams[at]), poses));
            }
        }
        None
    }

    /// Runs work on a compute pool with the engine. Its flag, the session's end and its limit stop it.
    pub async fn compute<R: Send + 'static>(
        &mut self,
        order: WorkOrder,
        work: impl FnOnce(&mut LoadedDeformer, &Work<'_>) -> R + Send + 'static,
    ) -> Result<(R, Arc<WorkWatch>), Error> {
        self.place.account().check_work()?;
        let owner = self.session.work_owner();
        let kind = order.kind;
        let span = WorkSpan::new(kind, &self.session.id, &order.call);
        let state = self.history.current();
        // After an edit, an undo or a failure the handles are set again before anything is solved.
        let lane = self.lane_with_handles(order.lane, state, &state.handles);
        let slot = tokio::select! {
            biased;
            () = self.session.closing.cancelled() => return Err(self.session.why()),
            slot = self.shared.compute.slot(lane, &owner, order.arrived, order.limit) => slot?,
        };
        let lost = || Error::new(ErrorCode::Internal, "the session's engine is gone");
        let mut deformer = self.deformer.take().ok_or_else(lost)?;
        let flags = vec![order.flag, Arc::clone(&self.session.cancel)];
        let watch = WorkWatch::since(order.arrived, flags, order.limit)
            .within(Arc::clone(&self.memory), self.history.byte_size());
        let watch = Arc::new(watch);
        let (inside, queued) = (Arc::clone(&watch), slot.queued);
        let begun = std::time::Instant::now();
        *self.session.work() = Some((kind, Arc::clone(&watch)));
        let ran = slot.run(span, move |pool| {
            let here = Work {
                pool,
                watch: &inside,
                queued,
            };
            let value = work(&mut deformer, &here);
            (deformer, value)
        });
        let ran = ran.await;
        *self.session.work() = None;
        self.place.account().charge_work(begun.elapsed());
        match ran {
            Ok((deformer, value)) => {
                self.deformer = Some(deformer);
                self.count_memory();
                Ok((value, watch))
            }
            Err(WorkPanicked(text)) => {
                self.shared.metrics.sessions_failed.inc();
                tracing::error!(session.id = %self.session.id, panic = text, "work panicked; the session is closed");
                let error = Error::from(WorkPanicked(text));
                self.session.close(Error {
                    message: format!("{error}; the session is closed"),
                    ..error
                });
                Err(self.session.why())
            }
        }
    }

    /// Keeps a solved pose, commits it, publishes it and counts it; returns the digest of its shape.
    pub async fn commit_pose(
        &mut self,
        posed: PosedState,
        frame: &Frame,
        cycles: u32,
        claim: Option<&KeyClaim<StoredAnswer>>,
    ) -> Result<String, Error> {
        self.keep_pose(&posed, frame, claim).await?;
        let digest = posed.digest.clone();
        self.history.commit_pose(posed);
        self.publish_view();
        self.shared.metrics.commits.inc();
        self.count_solve(frame, cycles);
        Ok(digest)
    }

    /// Counts a solved pose.
    pub fn count_solve(&self, frame: &Frame, cycles: u32) {
        let metrics = &self.shared.metrics;
        metrics.solve.observe(frame.header.solve_ms / 1e3);
        metrics.cycles.inc_by(cycles.into());
        metrics.poses_solved.inc();
    }

    /// What the failure of a piece of work means to its caller.
    pub fn failure(&self, error: engine::Error, watch: &WorkWatch) -> Error {
        if error != engine::Error::Cancelled {
            return error.into();
        }
        self.shared.metrics.cancelled.inc();
        if self.session.cancel.cancelled() {
            self.session.why()
        } else if watch.abandoned() {
            Error::new(ErrorCode::Cancelled, "the caller gave up")
        } else {
            let text = format!(
                "took longer than the {} ms that are allowed, {} of them in line; nothing has changed",
                watch.limit().as_millis(),
                watch.waited().as_millis()
            );
            Error::new(ErrorCode::DeadlineExceeded, text)
        }
    }

    /// Publishes the state.
    pub fn publish_view(&mut self) {
        self.session.publish(view_of(&self.history, &self.build_ms));
        self.count_memory();
    }

    /// Counts in the ledger what it holds.
    pub fn count_memory(&self) {
        let engine = self.deformer.as_ref().map_or(0, LoadedDeformer::byte_size);
        let parts = self.adopted_parts.as_ref().map_or(0, AdoptedParts::byte_size);
        let bytes = engine.saturating_add(self.history.byte_size()).saturating_add(parts);
        // What work makes it asks for before; what a pose leaves in the solver is little, and counts anyway.
        let _ = self.memory.resize(bytes);
    }
}

/// The state that a history is in, as others see it.
pub(crate) fn view_of(history: &CommitHistory, build_ms: &BTreeMap<String, f64>) -> SessionView {
    let state = history.current();
    // The current shape is always at hand; `go_to_commit` and the commits see to it.
    let shape = history.shape(state.shape);
    SessionView {
        revision: history.revision(),
        facts: facts_of(state),
        handles: Arc::clone(&state.handles),
        poses: state.poses.clone(),
        build_ms: build_ms.clone(),
        positions: shape.map(|s| s.positions).unwrap_or_default(),
        digest: state.digest.clone(),
        history: history.show(),
    }
}

/// The facts of a state: those of model, solver and handles, and the warnings of the poses.
fn facts_of(state: &SessionState) -> Arc<pb::Session> {
    if state.pose_warnings.is_empty() {
        return Arc::clone(&state.facts);
    }
    let mut facts = state.facts.as_ref().clone();
    facts.warnings.extend(state.pose_warnings.iter().cloned());
    Arc::new(facts)
}

/// Deforming needs handles.
pub(crate) fn no_handles() -> Error {
    Error::new(
        ErrorCode::FailedPrecondition,
        "no handles are set; set them before deforming",
    )
}

impl SessionTask {
    /// When the next step out of memory is due; `None` while the session stays as it is.
    pub fn next_eviction(&self) -> Option<Instant> {
        self.kept.as_ref()?;
        if self.is_pinned() {
            return None;
        }
        let (used, idle) = (self.session.lease.last_use(), self.shared.config.idle);
        Some(match self.memory_state {
            MemoryState::Full => used + idle / 2,
            MemoryState::Trimmed => used + idle,
        })
    }

    /// Whether a stream or an animation needs the session as it is.
    fn is_pinned(&self) -> bool {
        !self.session.streams.all().is_empty() || self.session.animations.is_any()
    }

    /// Takes the next step out of memory if it is due, or all of them when another session needs room. Returns whether
    /// the session is to end here.
    pub async fn evict(&mut self) -> bool {
        let is_asked = self.session.leave.load(SeqCst) || self.is_to_be_given_back();
        if self.kept.is_none() || self.is_pinned() {
            self.session.leave.store(false, SeqCst);
            return false;
        }
        let is_due = self.next_eviction().is_some_and(|due| due <= Instant::now());
        if !is_due && !is_asked {
            return false;
        }
        if self.memory_state == MemoryState::Full && !is_asked {
            self.trim();
            return false;
        }
        self.leave_memory().await
    }

    /// Whether other nodes wait for the session, since this one is about to stop.
    fn is_to_be_given_back(&self) -> bool {
        let is_shared = || self.kept.as_ref().is_some_and(|kept| kept.store.ownership().is_some());
        self.shared.draining.load(SeqCst) && is_shared()
    }

    fn trim(&mut self) {
        self.memory_state = MemoryState::Trimmed;
        if let Some(deformer) = &mut self.deformer {
            deformer.drop_derived();
        }
        self.history.drop_snapshots();
        self.count_memory();
    }

    /// Keeps the newest shape, so that the session reopens fast, and takes no more calls. Earlier calls are served.
    async fn leave_memory(&mut self) -> bool {
        if let Err(error) = self.keep_shape_now().await {
            tracing::warn!(session.id = %self.session.id, "an idle session stays in memory: {error}");
            self.session.leave.store(false, SeqCst);
            // Tried again after another idle time.
            self.session.lease.renew();
            return false;
        }
        let session = Arc::clone(&self.session);
        let lock = self.shared.locks.lock(&session.id).await;
        let text = "the session leaves memory; ask again";
        // Before the place for streams ends: who finds it ended has to know why.
        session.unloaded.store(true, SeqCst);
        if !session.streams.close_if_none() {
            session.unloaded.store(false, SeqCst);
            return false;
        }
        self.shared.registry.remove_this(&session);
        self.commands.close();
        while let Some(command) = self.commands.recv().await {
            self.serve_command(command).await;
        }
        session.close(Error::new(ErrorCode::Unavailable, text));
        self.give_back().await;
        tracing::info!(session.id = %session.id, "idle session left memory");
        drop(lock);
        true
    }

    /// Where several nodes share the store, another one may have it now.
    async fn give_back(&mut self) {
        let Some(ownership) = self.kept.as_ref().and_then(|kept| kept.store.ownership()) else {
            return;
        };
        let used_ms = self.shared.surroundings.ms_ago(self.session.lease.last_use().elapsed());
        if let Err(error) = ownership.release(&self.session.held, used_ms).await {
            tracing::warn!(session.id = %self.session.id, "the session stays this node's: {error}");
        }
    }
}
