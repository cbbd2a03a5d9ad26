//! Every session of the process: the functions that all transports call.
//!
//! A call finds its session (404), claims its idempotency key, hands a command to the session's task and waits for the answer.
//! What only reads the published view needs no task. Opening sessions is in `create`, stopping in `drain`.

use crate::asset::{FileSet, Format};
use crate::session::answers::{ExportedModel, KeyedAnswer, PositionBuffer, SolvedFrames, Tenant};
use crate::session::calls::command::{HistoryDirection, PendingCall, SessionCommand, SolveCall, StoredAnswer};
use crate::session::calls::create::create_session;
use crate::session::calls::handle_change::HandleChange;
use crate::session::calls::idempotency::{ClaimOutcome, IdempotencyKeys, KeyClaim, RequestFingerprint};
use crate::session::capacity::call_gate::CallGate;
use crate::session::capacity::compute_slots::ComputeSlots;
use crate::session::capacity::memory_budget::MemoryBudget;
use crate::session::capacity::work_watch::CancelOnDrop;
use crate::session::config::SessionConfig;
use crate::session::engine::{EngineOpener, OpenDeformer};
use crate::session::error::{Error, ErrorCode};
use crate::session::metrics::Metrics;
use crate::session::registry::{OpenSession, SessionRegistry};
use crate::session::shared::SharedResources;
use crate::session::stream::ends::DeformStream;
use crate::session::stream::mailbox::Mailbox;
use crate::wire::{self, DeformOptions, pb};
use crate::wire::{frames::encode, frames::f32_bytes};
use prost::Message as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::SeqCst};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_util::sync::CancellationToken;

/// Every session of this process. Cloning shares them.
#[derive(Clone)]
pub struct Manager {
    pub(in crate::session) shared: Arc<SharedResources>,
}

impl Manager {
    /// No session yet; starts the compute threads.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` for a configuration that makes no sense, `INTERNAL` when threads cannot be started.
    pub fn new(config: SessionConfig) -> Result<Self, Error> {
        Self::with_opener(config, OpenDeformer)
    }

    /// As [`Manager::new`], with another engine.
    pub fn with_opener(config: SessionConfig, opener: impl EngineOpener) -> Result<Self, Error> {
        config.validate()?;
        let metrics = Arc::new(Metrics::default());
        let shared = SharedResources {
            compute: ComputeSlots::new(&config, Arc::clone(&metrics))?,
            budget: MemoryBudget::new(config.memory_bytes, Arc::clone(&metrics)),
            seats: Arc::new(Semaphore::new(config.sessions)),
            registry: SessionRegistry::default(),
            idempotency: IdempotencyKeys::new(&config),
            opener: Box::new(opener),
            gate: CallGate::new(),
            numbers: AtomicU64::new(1),
            draining: AtomicBool::new(false),
            aborted: CancellationToken::new(),
            abort_flag: Arc::default(),
            metrics,
            config,
        };
        Ok(Self {
            shared: Arc::new(shared),
        })
    }

    /// The limits that clients are told.
    pub fn limits(&self) -> pb::Limits {
        self.shared.config.limits()
    }

    /// The configuration.
    pub fn config(&self) -> &SessionConfig {
        &self.shared.config
    }

    /// What happened so far.
    pub fn metrics(&self) -> &Metrics {
        &self.shared.metrics
    }

    /// Opens a session on a model. With a key that was used for the same model and options before, the first answer.
    ///
    /// # Cancel safety
    /// Dropping the future stops the build; nothing exists then.
    ///
    /// # Errors
    /// What is wrong with model or options; `RESOURCE_EXHAUSTED` when no session or memory is free or the model is
    /// larger than allowed; `UNAVAILABLE` while draining.
    pub async fn create(
        &self,
        tenant: &Tenant,
        files: FileSet,
        options: pb::CreateOptions,
        key: Option<&str>,
    ) -> Result<KeyedAnswer<pb::Session>, Error> {
        create_session(&self.shared, tenant, files, options, key).await
    }

    /// Describes a session and renews its lease.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn get(&self, tenant: &Tenant, id: &str) -> Result<pb::Session, Error> {
        Ok(self.find(tenant, id)?.describe())
    }

    /// A page of the tenant's sessions, oldest first. Renews no lease.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` for a page size or token that is not allowed.
    pub async fn list(
        &self,
        tenant: &Tenant,
        request: pb::ListSessionsRequest,
    ) -> Result<pb::ListSessionsResponse, Error> {
        let size = match request.page_size {
            0 => 100,
            n @ 1..=1000 => n as usize,
            n => return Err(Error::invalid("pageSize", format!("is {n}, at most 1000 is allowed"))),
        };
        let after = match request.page_token.as_str() {
            "" => 0,
            token => u64::from_str_radix(token, 16)
                .map_err(|_| Error::invalid("pageToken", "is no token that an earlier page gave"))?,
        };
        let mut sessions = self.shared.registry.all();
        sessions.retain(|s| s.tenant == *tenant && s.number > after && !s.closing.is_cancelled());
        sessions.sort_unstable_by_key(|s| s.number);
        let more = sessions.len() > size;
        sessions.truncate(size);
        let token = sessions.last().filter(|_| more).map(|s| format!("{:x}", s.number));
        Ok(pb::ListSessionsResponse {
            sessions: sessions.iter().map(|s| s.describe()).collect(),
            next_page_token: token.unwrap_or_default(),
        })
    }

    /// Closes a session: its work stops within a cycle, its streams end with `NOT_FOUND`, its memory is free when this
    /// returns.
    ///
    /// # Cancel safety
    /// The session is closed even when the future is dropped.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn delete(&self, tenant: &Tenant, id: &str) -> Result<(), Error> {
        let session = self.find(tenant, id)?;
        let _inside = self.shared.gate.enter();
        self.shared.registry.remove(id);
        let text = format!("session \"{id}\" was deleted");
        session.close(Error::new(ErrorCode::NotFound, text));
        session.ended.cancelled().await;
        tracing::info!(session.id = %id, "session deleted");
        Ok(())
    }

    /// Replaces all handles; one commit. The shape stays as it is until the next pose.
    ///
    /// # Cancel safety
    /// Dropping the future stops the work; the old handles stay unless the new ones were stored already.
    ///
    /// # Errors
    /// What is wrong with the handles; nothing has changed then.
    pub async fn set_handles(
        &self,
        tenant: &Tenant,
        request: pb::SetHandlesRequest,
        key: Option<&str>,
    ) -> Result<pb::Session, Error> {
        let session = self.find(tenant, &request.session_id)?;
        let claim = self.claim(tenant, key, "set_handles", &[&request.encode_to_vec()])?;
        self.change_handles(&session, HandleChange::Replace(wire::handle_set(&request)?), claim)
            .await
    }

    /// Changes the fields of one handle that `fields` names (in JSON names), or adds it; one commit. Everything else,
    /// poses included, stays.
    ///
    /// # Cancel safety
    /// As [`Manager::set_handles`].
    ///
    /// # Errors
    /// What is wrong with the handle; nothing has changed then.
    pub async fn put_handle(
        &self,
        tenant: &Tenant,
        id: &str,
        handle: pb::Handle,
        fields: &[String],
        key: Option<&str>,
    ) -> Result<pb::Session, Error> {
        let session = self.find(tenant, id)?;
        let names = fields.join(",");
        let parts: [&[u8]; 3] = [id.as_bytes(), names.as_bytes(), &handle.encode_to_vec()];
        let claim = self.claim(tenant, key, "put_handle", &parts)?;
        let patch = wire::handle_patch(&handle, fields, &session.view().handles.set)?;
        self.change_handles(&session, HandleChange::Put(Box::new(patch)), claim)
            .await
    }

    /// Removes one handle; one commit.
    ///
    /// # Cancel safety
    /// As [`Manager::set_handles`].
    ///
    /// # Errors
    /// `NOT_FOUND` for the session or the handle.
    pub async fn remove_handle(
        &self,
        tenant: &Tenant,
        id: &str,
        handle_id: &str,
        key: Option<&str>,
    ) -> Result<pb::Session, Error> {
        let session = self.find(tenant, id)?;
        let claim = self.claim(tenant, key, "remove_handle", &[id.as_bytes(), handle_id.as_bytes()])?;
        self.change_handles(&session, HandleChange::Remove(handle_id.to_owned()), claim)
            .await
    }

    /// Solves one pose and commits it.
    ///
    /// # Cancel safety
    /// Dropping the future stops the solve within a cycle; the old state stays unless the pose was committed already.
    ///
    /// # Errors
    /// What is wrong with pose or options, `FAILED_PRECONDITION` without handles, `DEADLINE_EXCEEDED` when it takes
    /// longer than the server allows. Nothing has changed then.
    pub async fn solve(
        &self,
        tenant: &Tenant,
        request: pb::SolveRequest,
        key: Option<&str>,
    ) -> Result<SolvedFrames, Error> {
        let session = self.find(tenant, &request.session_id)?;
        let options = request.options.unwrap_or_default();
        let settings = DeformOptions::check(&options, "options", self.shared.config.window)?;
        let claim = match self.claim(tenant, key, "solve", &[&request.encode_to_vec()])? {
            Some(ClaimOutcome::Done(StoredAnswer::Solved {
                frame,
                revision,
                digest,
            })) => {
                let positions = Arc::clone(&frame.positions);
                let frames = self.shared.compute.offload(move || encode(*frame).collect()).await?;
                return Ok(SolvedFrames {
                    frames,
                    revision,
                    positions,
                    digest,
                });
            }
            Some(ClaimOutcome::Done(_)) => {
                return Err(Error::new(ErrorCode::Internal, "the kept answer is of another call"));
            }
            Some(ClaimOutcome::New(claim)) => Some(claim),
            None => None,
        };
        self.shared.metrics.poses_received.inc();
        let pose = request.pose.unwrap_or_default();
        let call = SolveCall {
            seq: pose.seq,
            changes: wire::pose_changes(&pose)?,
            settings,
        };
        self.call(&session, claim, |pending| SessionCommand::Solve(Box::new(call), pending))
        .await
    }

    /// Goes back by one commit; positions are restored to the bit.
    ///
    /// # Cancel safety
    /// Dropping the future leaves the session in the old or in the new state.
    ///
    /// # Errors
    /// `FAILED_PRECONDITION` when nothing is left to undo.
    pub async fn undo(&self, tenant: &Tenant, id: &str, key: Option<&str>) -> Result<pb::Session, Error> {
        self.step_history(tenant, id, HistoryDirection::Undo, key).await
    }

    /// Goes forward again by one undone commit.
    ///
    /// # Cancel safety
    /// As [`Manager::undo`].
    ///
    /// # Errors
    /// `FAILED_PRECONDITION` when nothing is left to redo.
    pub async fn redo(&self, tenant: &Tenant, id: &str, key: Option<&str>) -> Result<pb::Session, Error> {
        self.step_history(tenant, id, HistoryDirection::Redo, key).await
    }

    /// The commits that can be gone to, oldest first.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn history(&self, tenant: &Tenant, id: &str) -> Result<pb::HistoryResponse, Error> {
        Ok(self.find(tenant, id)?.view().history.clone())
    }

    /// The model in its current committed shape, in `format` or the one that it came in.
    ///
    /// # Cancel safety
    /// Dropping the future discards the files.
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` when the model cannot be written in that format.
    pub async fn export(&self, tenant: &Tenant, id: &str, format: Option<Format>) -> Result<ExportedModel, Error> {
        let session = self.find(tenant, id)?;
        self.call(&session, None, |call| SessionCommand::Export(format, call))
            .await
    }

    /// The entity tag that [`Manager::export`] would answer with, for nothing.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn export_etag(&self, tenant: &Tenant, id: &str, format: Option<Format>) -> Result<String, Error> {
        let session = self.find(tenant, id)?;
        Ok(OpenSession::etag(
            &session.view(),
            format.unwrap_or(session.format).name(),
        ))
    }

    /// The current committed positions as one buffer.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn positions(&self, tenant: &Tenant, id: &str) -> Result<PositionBuffer, Error> {
        let view = self.find(tenant, id)?.view();
        let etag = OpenSession::etag(&view, "f32");
        let bytes = self.shared.compute.offload(move || f32_bytes(&view.positions)).await?;
        Ok(PositionBuffer { bytes, etag })
    }

    /// Opens an interactive stream on a session. It starts from the committed poses.
    ///
    /// # Errors
    /// `NOT_FOUND`, `RESOURCE_EXHAUSTED` when the session has as many streams as allowed, `UNAVAILABLE` while draining.
    pub async fn stream(&self, tenant: &Tenant, id: &str) -> Result<DeformStream, Error> {
        let session = self.find(tenant, id)?;
        if self.shared.draining.load(SeqCst) {
            return Err(Error::draining());
        }
        let (config, metrics) = (&self.shared.config, Arc::clone(&self.shared.metrics));
        let mailbox = Mailbox::new(&session.id, config, Arc::clone(&metrics), Arc::clone(&session.wake))?;
        let mailbox = Arc::new(mailbox);
        session.streams.add(Arc::clone(&mailbox)).inspect_err(|_| {
            metrics.refused.inc();
        })?;
        let inside = self.shared.gate.enter();
        let stream = DeformStream::new(mailbox, session, config.part_bytes, metrics, inside);
        // A drain that began meanwhile may have missed this stream.
        if self.shared.draining.load(SeqCst) {
            Err(Error::draining())
        } else {
            Ok(stream)
        }
    }

    pub(in crate::session) fn find(&self, tenant: &Tenant, id: &str) -> Result<Arc<OpenSession>, Error> {
        self.shared.registry.find(tenant, id)
    }

    pub(in crate::session) fn claim(
        &self,
        tenant: &Tenant,
        key: Option<&str>,
        operation: &str,
        parts: &[&[u8]],
    ) -> Result<Option<ClaimOutcome<StoredAnswer>>, Error> {
        let claim = |key| {
            self.shared
                .idempotency
                .claim(tenant, key, RequestFingerprint::of(operation, parts))
        };
        key.map(claim).transpose()
    }

    async fn change_handles(
        &self,
        session: &Arc<OpenSession>,
        change: HandleChange,
        claim: Option<ClaimOutcome<StoredAnswer>>,
    ) -> Result<pb::Session, Error> {
        self.call_for_session(session, claim, |call| SessionCommand::SetHandles(change, call))
            .await
    }

    async fn step_history(
        &self,
        tenant: &Tenant,
        id: &str,
        direction: HistoryDirection,
        key: Option<&str>,
    ) -> Result<pb::Session, Error> {
        let session = self.find(tenant, id)?;
        let operation = if direction == HistoryDirection::Undo {
            "undo"
        } else {
            "redo"
        };
        let claim = self.claim(tenant, key, operation, &[id.as_bytes()])?;
        self.call_for_session(&session, claim, |call| SessionCommand::Step(direction, call))
            .await
    }

    /// Makes a call that answers with the session, or gives the answer kept for its key.
    async fn call_for_session(
        &self,
        session: &Arc<OpenSession>,
        claim: Option<ClaimOutcome<StoredAnswer>>,
        command: impl FnOnce(PendingCall<pb::Session>) -> SessionCommand,
    ) -> Result<pb::Session, Error> {
        let claim = match claim {
            Some(ClaimOutcome::Done(StoredAnswer::Session(session))) => return Ok(*session),
            Some(ClaimOutcome::Done(_)) => {
                return Err(Error::new(ErrorCode::Internal, "the kept answer is of another call"));
            }
            Some(ClaimOutcome::New(claim)) => Some(claim),
            None => None,
        };
        self.call(session, claim, command).await
    }

    /// Sends a command to the session's task and waits for its answer.
    ///
    /// # Cancel safety
    /// Dropping the future raises the command's flag.
    pub(in crate::session) async fn call<T>(
        &self,
        session: &Arc<OpenSession>,
        claim: Option<KeyClaim<StoredAnswer>>,
        command: impl FnOnce(PendingCall<T>) -> SessionCommand,
    ) -> Result<T, Error> {
        let _inside = self.shared.gate.enter();
        let guard = CancelOnDrop::default();
        let (reply, answer) = oneshot::channel();
        let command = command(PendingCall {
            reply,
            cancel: Arc::clone(&guard.0),
            claim,
        });
        session.commands.try_send(command).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => {
                self.shared.metrics.refused.inc();
                let text = format!(
                    "{} calls wait on this session already",
                    self.shared.config.session_queue
                );
                Error::exhausted(text, 1)
            }
            mpsc::error::TrySendError::Closed(_) => session.why(),
        })?;
        answer.await.unwrap_or_else(|_| Err(session.why()))
    }
}

impl std::fmt::Debug for Manager {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Manager({} sessions)", self.shared.metrics.sessions.get())
    }
}
