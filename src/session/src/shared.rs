//! What all sessions of a process share.

use crate::calls::command::StoredAnswer;
use crate::calls::idempotency::IdempotencyKeys;
use crate::capacity::call_queue::CallGate;
use crate::capacity::compute_slots::ComputeSlots;
use crate::capacity::memory_ledger::MemoryLedger;
use crate::config::SessionConfig;
use crate::engine::EngineOpener;
use crate::error::Error;
use crate::keeping::lease_watch::LeaseWatch;
use crate::keeping::lease_watch::SessionLocks;
use crate::metrics::Metrics;
use crate::quota::tenant_account::TenantAccounts;
use crate::registry::{OpenSession, SessionRegistry};
use crate::store::Store;
use crate::surroundings::Surroundings;
use pliant_exec::progress::CancelFlag;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

/// What all sessions share.
pub(super) struct SharedResources {
    pub config: SessionConfig,
    pub metrics: Arc<Metrics>,
    pub compute: ComputeSlots,
    pub ledger: Arc<MemoryLedger>,
    /// One permit for each session that may be held.
    pub session_permits: Arc<Semaphore>,
    /// What each tenant uses.
    pub accounts: TenantAccounts,
    /// One permit for each animation that may be under way.
    pub animations: Arc<Semaphore>,
    pub registry: SessionRegistry,
    /// Where sessions are kept; without it they end with the process.
    pub store: Option<Arc<Store>>,
    /// When this node, of several, renewed its lease.
    pub lease_watch: LeaseWatch,
    /// Held while a session moves into memory or out.
    pub locks: SessionLocks,
    pub idempotency: IdempotencyKeys<StoredAnswer>,
    pub opener: Box<dyn EngineOpener>,
    pub surroundings: Arc<dyn Surroundings>,
    pub gate: CallGate,
    pub numbers: AtomicU64,
    /// When this server began, in milliseconds since 1970. The time to live does not pass while no server runs, so that
    /// neither a stop nor a backup's age ends a session.
    pub started_ms: u64,
    pub draining: AtomicBool,
    /// Raised by `abort`.
    pub aborted: CancellationToken,
    pub abort_flag: Arc<CancelFlag>,
}

impl SharedResources {
    /// Removes a session that another node has.
    pub fn drop_ownership(&self, session: &Arc<OpenSession>) {
        // A write that is refused and a heartbeat may both find out: the first of them counts.
        let is_news = self.registry.remove_this(session);
        session.close(Error::moved());
        if is_news {
            tracing::warn!(session.id = %session.id, "another node has taken the session");
            self.metrics.sessions_lost.inc();
        }
    }
}
