//! Every session of the process: the functions that all transports call.
//!
//! A call finds its session (404), claims its idempotency key, hands a command to the session's task and waits for the answer.
//! What only reads the published view needs no task. Here are the sessions themselves and what all calls have in common;
//! what changes a session is in `commits`, what reads its shape in `shape`, opening in `create`, stopping in `drain`.
//!
//! Calls take values that `wire` has read and checked; those that describe a session or an edit answer with its message.

use crate::answers::{CallKey, KeyedAnswer, SessionList, Tenant};
use crate::audit::audit_entry::{AuditEntry, AuditedAction};
use crate::audit::audit_trail::note;
use crate::calls::command::{CallOrigin, KeyedCall, QueuedCall, StoredAnswer, TaskCall};
use crate::calls::create::{CreatedSession, create_session};
use crate::calls::idempotency::{ClaimOutcome, IdempotencyKeys, KeyClaim};
use crate::calls::shared_keys::claim_everywhere;
use crate::capacity::call_queue::CallGate;
use crate::capacity::call_queue::MIN_TTL;
use crate::capacity::compute_slots::ComputeSlots;
use crate::capacity::memory_ledger::MemoryLedger;
use crate::capacity::work_watch::CancelOnDrop;
use crate::config::SessionConfig;
use crate::engine::{EngineOpener, OpenDeformer};
use crate::error::{Error, ErrorCode};
use crate::keeping::heartbeat::{be_sure_of_lease, beat, beat_for_ever, refuse_stale_state};
use crate::keeping::kept_session::listed_facts;
use crate::keeping::lease_watch::LeaseWatch;
use crate::keeping::lease_watch::SessionLocks;
use crate::keeping::reopen::{claim_session, reopen_session};
use crate::keeping::sweep::sweep_for_ever;
use crate::metrics::Metrics;
use crate::quota::tenant_account::TenantAccount;
use crate::quota::tenant_account::TenantAccounts;
use crate::registry::{OpenSession, SessionRegistry};
use crate::shared::SharedResources;
use crate::store::{Store, StoreError};
use crate::surroundings::RealSurroundings;
use pliant_asset::FileSet;
use pliant_core::engine::HandleSet;
use pliant_wire::{SessionOptions, SessionPage, pb};
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_util::sync::CancellationToken;
use tracing::Span;

/// How long a call waits until it looks again whether it will be served in time.
const BETWEEN_LOOKS: Duration = Duration::from_secs(1);

/// Every session of this process. Cloning shares them.
#[derive(Clone)]
pub struct Manager {
    pub(crate) shared: Arc<SharedResources>,
    /// Who is noted to have asked.
    pub(crate) who: Arc<str>,
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
        Self::put_together(config, opener, None, 1)
    }

    /// Sessions that are kept in a store: those that it holds, and new ones. To be called inside a runtime, on which the store is looked
    /// after.
    ///
    /// # Errors
    /// As [`Manager::new`]; `UNAVAILABLE` when the store does not answer.
    pub async fn with_store(
        config: SessionConfig,
        opener: impl EngineOpener,
        store: Arc<Store>,
    ) -> Result<Self, Error> {
        let first = store.highest_number().await?.saturating_add(1);
        // Where several nodes share the store, each key is read from it when it is used: another node may take back a commit with its key.
        let kept_keys = match store.is_writable() && store.ownership().is_none() {
            true => store.keys().await?,
            false => Vec::new(),
        };
        let stored = store.sessions_by_tenant().await?;
        let manager = Self::put_together(config, opener, Some(store), first)?;
        let shared = &manager.shared;
        for (tenant, sessions) in stored {
            shared.accounts.of(&tenant)?.count_stored(sessions);
        }
        let now = shared.surroundings.now_ms();
        for key in kept_keys {
            let age = Duration::from_millis(now.saturating_sub(key.at_ms));
            if age < shared.config.idempotency_age {
                let answer = StoredAnswer::Recorded {
                    session: key.session.clone(),
                    sequence: key.sequence,
                };
                let bytes = answer.byte_size();
                shared.idempotency.restore(&key, age, answer, bytes);
            }
        }
        beat(shared).await?;
        tokio::spawn(beat_for_ever(Arc::downgrade(shared)));
        tokio::spawn(sweep_for_ever(Arc::downgrade(shared)));
        Ok(manager)
    }

    fn put_together(
        config: SessionConfig,
        opener: impl EngineOpener,
        store: Option<Arc<Store>>,
        first_number: u64,
    ) -> Result<Self, Error> {
        config.validate()?;
        let surroundings = match &store {
            Some(store) => store.surroundings(),
            None => Arc::new(RealSurroundings),
        };
        let metrics = Arc::new(Metrics::default());
        let limit = i64::try_from(config.memory_bytes).unwrap_or(i64::MAX);
        metrics.bytes_limit.set(limit);
        let ledger = MemoryLedger::new(config.memory_bytes, Arc::clone(&metrics));
        let shared = SharedResources {
            compute: ComputeSlots::new(&config, Arc::clone(&metrics), surroundings.computes_inline())?,
            session_permits: Arc::new(Semaphore::new(config.sessions)),
            accounts: TenantAccounts::new(config.quotas.clone(), metrics.refused.clone()),
            animations: Arc::new(Semaphore::new(config.animations)),
            registry: SessionRegistry::default(),
            store,
            lease_watch: LeaseWatch::default(),
            locks: SessionLocks::default(),
            idempotency: IdempotencyKeys::new(&config, &ledger),
            ledger,
            opener: Box::new(opener),
            gate: CallGate::new(),
            numbers: AtomicU64::new(first_number),
            started_ms: surroundings.now_ms(),
            surroundings,
            draining: AtomicBool::new(false),
            aborted: CancellationToken::new(),
            abort_flag: Arc::default(),
            metrics,
            config,
        };
        Ok(Self {
            shared: Arc::new(shared),
            who: "anyone".into(),
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
    ) -> Result<KeyedAnswer<pb::Session>, Error> {
        let is_shared = self
            .shared
            .store
            .as_ref()
            .is_some_and(|store| store.ownership().is_some());
        // Another node that refused the creation may have taken the session and its key back since the key was read.
        let mut may_try_again = is_shared && key.is_some();
        loop {
            let (files, options, key) = (files.clone(), options.clone(), key.clone());
            let answer = match create_session(&self.shared, tenant, &self.who, files, options, key).await? {
                CreatedSession::Now(value) => {
                    return Ok(KeyedAnswer {
                        value: *value,
                        repeated: false,
                    });
                }
                CreatedSession::Before(answer) => answer,
            };
            match self.kept_answer(tenant, answer).await {
                Err(error) if may_try_again && matches!(error.code, ErrorCode::NotFound | ErrorCode::AlreadyExists) => {
                    may_try_again = false;
                }
                kept => {
                    return Ok(KeyedAnswer {
                        value: kept?.try_into()?,
                        repeated: true,
                    });
                }
            }
        }
    }

    /// Describes a session and renews its lease.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn get(&self, tenant: &Tenant, id: &str) -> Result<pb::Session, Error> {
        Ok(self.find(tenant, id).await?.describe_with_work())
    }

    /// The handles in force.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn handles(&self, tenant: &Tenant, id: &str) -> Result<HandleSet, Error> {
        Ok(self.find(tenant, id).await?.view().handles.set.clone())
    }

    /// A page of the tenant's sessions, oldest first. Renews no lease, and brings no session into memory.
    ///
    /// # Errors
    /// `UNAVAILABLE` when sessions are kept in a store and it does not answer.
    pub async fn list(&self, tenant: &Tenant, page: SessionPage) -> Result<SessionList, Error> {
        if let Some(store) = &self.shared.store {
            return self.list_stored(store, tenant, page).await;
        }
        let mut sessions = self.shared.registry.all();
        sessions.retain(|s| s.tenant == *tenant && s.number > page.after && !s.closing.is_cancelled());
        let more = sessions.len() > page.size;
        sessions.truncate(page.size);
        Ok(SessionList {
            sessions: sessions.iter().map(|s| s.describe()).collect(),
            next_after: sessions.last().filter(|_| more).map(|s| s.number),
        })
    }

    async fn list_stored(&self, store: &Store, tenant: &Tenant, page: SessionPage) -> Result<SessionList, Error> {
        let mut found = store.list(tenant, page.after, page.size + 1).await?;
        let more = found.len() > page.size;
        found.truncate(page.size);
        let next_after = found.last().filter(|_| more).map(|(number, _)| *number);
        let mut sessions = Vec::with_capacity(found.len());
        for (_, listed) in found {
            let Some(listed) = listed else { continue };
            sessions.push(match self.shared.registry.peek(&listed.record.id) {
                Some(open) => open.describe(),
                None => listed_facts(&listed, self.shared.started_ms)?,
            });
        }
        Ok(SessionList { sessions, next_after })
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
        let _inside = self.shared.gate.enter();
        // No call brings it into memory meanwhile.
        be_sure_of_lease(&self.shared).await;
        let lock = self.shared.locks.lock(id).await;
        let session = self.shared.registry.find(tenant, id);
        match (&self.shared.store, &session) {
            (None, Err(error)) => return Err(error.clone()),
            (None, Ok(_)) => self.audit_entry(tenant, AuditedAction::Delete, id).log(),
            (Some(store), _) => {
                let generation = match &session {
                    Ok(session) => session.held.generation,
                    Err(_) => claim_session(&self.shared, store, tenant, id).await?,
                };
                let audit = self.audit_entry(tenant, AuditedAction::Delete, id);
                let deleted = store.delete(audit, generation).await;
                if let (Err(StoreError::Moved), Ok(session)) = (&deleted, &session) {
                    self.shared.drop_ownership(session);
                }
                deleted?;
                self.account(tenant)?.uncount_session();
            }
        }
        if let Ok(session) = session {
            self.shared.registry.remove(id);
            let text = format!("session \"{id}\" was deleted");
            session.close(Error::new(ErrorCode::NotFound, text));
            // Its task may be on its way out and wait for it.
            drop(lock);
            session.ended.cancelled().await;
        }
        tracing::info!(session.id = %id, "session deleted");
        Ok(())
    }

    /// The commits that can be gone to, oldest first.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn history(&self, tenant: &Tenant, id: &str) -> Result<pb::HistoryResponse, Error> {
        let view = self.find(tenant, id).await?.view();
        Ok(pb::HistoryResponse {
            commits: view.history.list.iter().cloned().collect(),
            current: view.history.current,
        })
    }

    /// The tenant's session of that id, its lease renewed; one that has left memory comes back.
    pub(crate) async fn find(&self, tenant: &Tenant, id: &str) -> Result<Arc<OpenSession>, Error> {
        be_sure_of_lease(&self.shared).await;
        match (self.shared.registry.find(tenant, id), &self.shared.store) {
            (Err(error), Some(_)) if error.code == ErrorCode::NotFound && self.shared.draining.load(SeqCst) => {
                Err(self.leaving().await)
            }
            (Err(error), Some(store)) if error.code == ErrorCode::NotFound => {
                reopen_session(&self.shared, store, tenant, id).await
            }
            (found, _) => found,
        }
    }

    /// Makes a call on a session, or gives the answer that is kept for its key.
    ///
    /// # Cancel safety
    /// As [`Manager::call`].
    pub(crate) async fn keyed_call<C: KeyedCall>(
        &self,
        tenant: &Tenant,
        id: &str,
        key: Option<CallKey>,
        call: C,
    ) -> Result<C::Answer, Error> {
        let session = self.find(tenant, id).await?;
        match self.claim_call(&session, key, &call).await? {
            ControlFlow::Break(answer) => Ok(answer),
            ControlFlow::Continue(claim) => self.call(&session, claim, call).await,
        }
    }

    /// Claims the key of a call, or breaks with the answer that is kept for it.
    pub(crate) async fn claim_call<C: KeyedCall>(
        &self,
        session: &OpenSession,
        key: Option<CallKey>,
        call: &C,
    ) -> Result<ControlFlow<C::Answer, Option<KeyClaim<StoredAnswer>>>, Error> {
        refuse_stale_state(&self.shared)?;
        let Some(CallKey { key, request }) = key else {
            return Ok(ControlFlow::Continue(None));
        };
        let fingerprint = call.fingerprint(&session.id, &request);
        Ok(
            match claim_everywhere(&self.shared, &session.tenant, &key, fingerprint).await? {
                ClaimOutcome::New(claim) => ControlFlow::Continue(Some(claim)),
                ClaimOutcome::Done(answer) => {
                    ControlFlow::Break(self.kept_answer(&session.tenant, answer).await?.try_into()?)
                }
            },
        )
    }

    /// Sends a command to the session's task and waits for its answer.
    ///
    /// # Cancel safety
    /// Dropping the future raises the command's flag.
    pub(crate) async fn call<C: TaskCall>(
        &self,
        session: &Arc<OpenSession>,
        claim: Option<KeyClaim<StoredAnswer>>,
        call: C,
    ) -> Result<C::Answer, Error> {
        let _inside = self.shared.gate.enter();
        let guard = CancelOnDrop::default();
        let (reply, mut answer) = oneshot::channel();
        let arrived = Instant::now();
        let ahead = session.line.waiting();
        (self.shared.compute).refuse_long_line(ahead, session.line.expected(ahead), arrived)?;
        let origin = CallOrigin {
            who: Arc::clone(&self.who),
            cancel: Arc::clone(&guard.0),
            arrived,
            claim,
            span: Span::current(),
        };
        let mut command = C::queued(QueuedCall { call, origin, reply });
        let mut session = Arc::clone(session);
        while let Err(error) = session.commands.try_send(command) {
            match error {
                mpsc::error::TrySendError::Full(_) => {
                    self.shared.metrics.refused.inc();
                    let text = format!(
                        "{} calls wait on this session already",
                        self.shared.config.session_queue
                    );
                    return Err(Error::exhausted(text, 1));
                }
                // It left memory since it was found, and comes back for the call.
                mpsc::error::TrySendError::Closed(refused) if session.has_left() => {
                    command = refused;
                    session = self.find(&session.tenant, &session.id).await?;
                }
                mpsc::error::TrySendError::Closed(_) => return Err(session.why()),
            }
        }
        let place = session.line.join();
        loop {
            // How long the calls before it take shows while it waits.
            match tokio::time::timeout(BETWEEN_LOOKS, &mut answer).await {
                Ok(answer) => return answer.unwrap_or_else(|_| Err(session.why())),
                Err(_) => {
                    let ahead = session.line.ahead_of(place);
                    (self.shared.compute).refuse_long_line(ahead, session.line.expected(ahead), arrived)?;
                }
            }
        }
    }
}

impl std::fmt::Debug for Manager {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Manager({} sessions)", self.shared.metrics.sessions.get())
    }
}

impl Manager {
    /// The same sessions, with calls noted as those of `who`, a name that authentication gave.
    #[must_use]
    pub fn on_behalf_of(&self, who: &Arc<str>) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
            who: Arc::clone(who),
        }
    }

    /// The entry that says what the caller does.
    pub(crate) fn audit_entry(&self, tenant: &Tenant, what: AuditedAction, id: &str) -> AuditEntry {
        AuditEntry {
            tenant: tenant.clone(),
            who: Arc::clone(&self.who),
            what,
            session: id.to_owned(),
        }
    }

    /// Notes what the caller does.
    pub(crate) async fn note(&self, tenant: &Tenant, what: AuditedAction, id: &str) {
        note(&self.shared, self.audit_entry(tenant, what, id)).await;
    }

    /// What a tenant may use, and what it uses.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where too many other tenants use something.
    pub fn account(&self, tenant: &Tenant) -> Result<Arc<TenantAccount>, Error> {
        self.shared.accounts.of(tenant)
    }

    /// The times to live that a tenant's sessions may ask for.
    ///
    /// # Errors
    /// As [`Manager::account`].
    pub fn ttl_range(&self, tenant: &Tenant) -> Result<RangeInclusive<Duration>, Error> {
        let longest = self.account(tenant)?.quota().max_ttl;
        Ok(MIN_TTL..=longest.unwrap_or(self.shared.config.max_ttl))
    }

    /// What a tenant may use and what it has left.
    ///
    /// # Errors
    /// As [`Manager::account`]; `UNAVAILABLE` when the store does not answer.
    pub async fn quotas_left(&self, tenant: &Tenant) -> Result<pb::Quotas, Error> {
        let account = self.account(tenant)?;
        let stored = match (&self.shared.store, account.stored_quota()) {
            (Some(store), Some(_)) => store.stored_bytes(tenant).await?,
            _ => 0,
        };
        Ok(account.report(stored))
    }
}
