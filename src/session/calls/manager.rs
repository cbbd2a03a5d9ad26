//! Every session of the process: the functions that all transports call.
//!
//! A call finds its session (404), claims its idempotency key, hands a command to the session's task and waits for the answer.
//! What only reads the published view needs no task. Here are the sessions themselves and what all calls have in common;
//! what changes a session is in `commits` and `edit`, what reads its shape in `shape`, opening in `create`, stopping in `drain`.
//!
//! Calls take values that `wire` has read and checked, and answer with values: no message comes in here, none goes out.

use crate::asset::FileSet;
use crate::engine::HandleSet;
use crate::session::answers::{CallKey, HistoryFacts, KeyedAnswer, SessionFacts, SessionList, Tenant};
use crate::session::calls::command::{PendingCall, SessionCommand, StoredAnswer};
use crate::session::calls::create::create_session;
use crate::session::calls::idempotency::{
    ClaimOutcome, IdempotencyKeys, KeyClaim, RequestFingerprint, answer_of_another_call,
};
use crate::session::capacity::call_gate::CallGate;
use crate::session::capacity::compute_slots::ComputeSlots;
use crate::session::capacity::memory_ledger::MemoryLedger;
use crate::session::capacity::work_watch::CancelOnDrop;
use crate::session::config::SessionConfig;
use crate::session::engine::{EngineOpener, OpenDeformer};
use crate::session::error::{Error, ErrorCode};
use crate::session::metrics::Metrics;
use crate::session::registry::{OpenSession, SessionRegistry};
use crate::session::shared::SharedResources;
use crate::wire::{SessionOptions, SessionPage};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Instant;
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
        let ledger = MemoryLedger::new(config.memory_bytes, Arc::clone(&metrics));
        let shared = SharedResources {
            compute: ComputeSlots::new(&config, Arc::clone(&metrics))?,
            seats: Arc::new(Semaphore::new(config.sessions)),
            animations: Arc::new(Semaphore::new(config.animations)),
            registry: SessionRegistry::default(),
            idempotency: IdempotencyKeys::new(&config, &ledger),
            ledger,
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

    /// The configuration.
    pub fn config(&self) -> &SessionConfig {
        &self.shared.config
    }

    /// What is held and may be held, by sessions and by whatever is on its way in or out.
    pub fn ledger(&self) -> &Arc<MemoryLedger> {
        &self.shared.ledger
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
        options: SessionOptions,
        key: Option<CallKey>,
    ) -> Result<KeyedAnswer<SessionFacts>, Error> {
        create_session(&self.shared, tenant, files, options, key).await
    }

    /// Describes a session and renews its lease.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn get(&self, tenant: &Tenant, id: &str) -> Result<SessionFacts, Error> {
        Ok(self.find(tenant, id)?.describe())
    }

    /// The handles in force.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn handles(&self, tenant: &Tenant, id: &str) -> Result<HandleSet, Error> {
        Ok(self.find(tenant, id)?.view().handles.set.clone())
    }

    /// A page of the tenant's sessions, oldest first. Renews no lease.
    pub async fn list(&self, tenant: &Tenant, page: SessionPage) -> SessionList {
        let mut sessions = self.shared.registry.all();
        sessions.retain(|s| s.tenant == *tenant && s.number > page.after && !s.closing.is_cancelled());
        sessions.sort_unstable_by_key(|s| s.number);
        let more = sessions.len() > page.size;
        sessions.truncate(page.size);
        SessionList {
            sessions: sessions.iter().map(|s| s.describe()).collect(),
            next_after: sessions.last().filter(|_| more).map(|s| s.number),
        }
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

    /// The commits that can be gone to, oldest first.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn history(&self, tenant: &Tenant, id: &str) -> Result<HistoryFacts, Error> {
        let view = self.find(tenant, id)?.view();
        Ok(HistoryFacts {
            commits: view.history.list.iter().cloned().collect(),
            current: view.history.current,
        })
    }

    pub(in crate::session) fn find(&self, tenant: &Tenant, id: &str) -> Result<Arc<OpenSession>, Error> {
        self.shared.registry.find(tenant, id)
    }

    /// Claims the idempotency key of a call, or gives the answer that is kept for it.
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

    /// Makes a call that answers with the session, or gives the answer kept for its key.
    pub(in crate::session) async fn call_for_session(
        &self,
        session: &Arc<OpenSession>,
        claim: Option<ClaimOutcome<StoredAnswer>>,
        command: impl FnOnce(PendingCall<SessionFacts>) -> SessionCommand,
    ) -> Result<SessionFacts, Error> {
        let claim = match claim {
            Some(ClaimOutcome::Done(StoredAnswer::Session(session))) => return Ok(*session),
            Some(ClaimOutcome::Done(_)) => return Err(answer_of_another_call()),
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
            arrived: Instant::now(),
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
