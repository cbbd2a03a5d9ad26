//! A store between sessions and the real one that fails, or holds calls, when a test says so.

use bytes::Bytes;
use pliant::session::store::{
    Commit, DatabaseStore, Generation, HeldSession, KeepSessions, ListedSession, LoggedKey, NewCommit, NewSession,
    ReadSessions, StoreError, Stored, StoredSession, UsedSession,
};
use pliant::session::{AuditEntry, Tenant};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::SeqCst};
use tokio::sync::watch;

/// A store that fails when it is asked to.
#[derive(Debug)]
pub struct FaultyStore {
    inner: Arc<DatabaseStore>,
    /// Calls so far, sweeps not among them.
    pub calls: AtomicU64,
    /// The call that fails; 0: none.
    pub fails_at: AtomicU64,
    /// Whether every call fails.
    pub is_away: AtomicBool,
    /// Whether commits wait.
    pub held: watch::Sender<bool>,
}

impl FaultyStore {
    /// A store that does not fail yet.
    pub fn over(inner: DatabaseStore) -> Self {
        Self {
            inner: Arc::new(inner),
            calls: AtomicU64::new(0),
            fails_at: AtomicU64::new(0),
            is_away: AtomicBool::new(false),
            held: watch::Sender::new(false),
        }
    }

    fn passes(&self) -> Result<(), StoreError> {
        let call = self.calls.fetch_add(1, SeqCst) + 1;
        match self.is_away.load(SeqCst) || call == self.fails_at.load(SeqCst) {
            true => Err(StoreError::Unavailable(format!("call {call} was made to fail"))),
            false => Ok(()),
        }
    }

    fn faulty<'a, T: 'a>(&'a self, call: Stored<'a, T>) -> Stored<'a, T> {
        Box::pin(async move {
            self.passes()?;
            call.await
        })
    }

    fn held<'a, T: 'a>(&'a self, call: Stored<'a, T>) -> Stored<'a, T> {
        Box::pin(async move {
            self.passes()?;
            let _ = self.held.subscribe().wait_for(|held| !held).await;
            call.await
        })
    }
}

impl ReadSessions for FaultyStore {
    fn build(&self) -> String {
        self.inner.build()
    }

    fn takes_writes(&self) -> bool {
        self.inner.takes_writes()
    }

    fn writable(&self) -> Result<&dyn KeepSessions, StoreError> {
        Ok(self)
    }

    fn load(&self, tenant: Tenant, id: String) -> Stored<'_, Option<StoredSession>> {
        self.faulty(self.inner.load(tenant, id))
    }

    fn commit(&self, session: String, sequence: u64) -> Stored<'_, Option<Commit>> {
        self.faulty(self.inner.commit(session, sequence))
    }

    fn holds(&self, tenant: Tenant, id: String) -> Stored<'_, bool> {
        self.faulty(self.inner.holds(tenant, id))
    }

    fn list(&self, tenant: Tenant, after: u64, most: usize) -> Stored<'_, Vec<(u64, Option<ListedSession>)>> {
        self.faulty(self.inner.list(tenant, after, most))
    }

    fn object(&self, name: String) -> Stored<'_, Bytes> {
        self.faulty(self.inner.object(name))
    }

    fn sessions_by_tenant(&self) -> Stored<'_, Vec<(Tenant, u64)>> {
        self.inner.sessions_by_tenant()
    }

    fn stored_bytes(&self, tenant: Tenant) -> Stored<'_, u64> {
        self.faulty(self.inner.stored_bytes(tenant))
    }

    fn count_sessions(&self, tenant: Tenant) -> Stored<'_, u64> {
        self.inner.count_sessions(tenant)
    }

    fn highest_number(&self) -> Stored<'_, u64> {
        self.inner.highest_number()
    }
}

impl KeepSessions for FaultyStore {
    fn create(&self, session: NewSession) -> Stored<'_, Generation> {
        self.held(self.inner.create(session))
    }

    fn append(&self, commit: NewCommit) -> Stored<'_, ()> {
        self.held(self.inner.append(commit))
    }

    fn save_snapshot(&self, session: HeldSession, sequence: u64, shape: Bytes) -> Stored<'_, ()> {
        self.faulty(self.inner.save_snapshot(session, sequence, shape))
    }

    fn rerecord_digests(&self, session: HeldSession, build: String, digests: Vec<(u64, String)>) -> Stored<'_, ()> {
        self.faulty(self.inner.rerecord_digests(session, build, digests))
    }

    fn delete(&self, audit: AuditEntry, generation: Generation) -> Stored<'_, ()> {
        self.faulty(self.inner.delete(audit, generation))
    }

    fn note_use(&self, sessions: Vec<UsedSession>) -> Stored<'_, ()> {
        self.inner.note_use(sessions)
    }

    fn expired(&self, since_ms: u64, now_ms: u64) -> Stored<'_, Vec<(Tenant, String)>> {
        self.inner.expired(since_ms, now_ms)
    }

    fn key(&self, tenant: Tenant, key: String) -> Stored<'_, Option<LoggedKey>> {
        self.inner.key(tenant, key)
    }

    fn keys(&self) -> Stored<'_, Vec<LoggedKey>> {
        self.inner.keys()
    }

    fn forget_keys(&self, before_ms: u64) -> Stored<'_, ()> {
        self.inner.forget_keys(before_ms)
    }

    fn audit(&self, entry: AuditEntry) -> Stored<'_, ()> {
        self.inner.audit(entry)
    }

    fn audited_tenants(&self) -> Stored<'_, Vec<Tenant>> {
        self.inner.audited_tenants()
    }

    fn forget_audit_of(&self, tenant: Tenant, before_ms: u64) -> Stored<'_, ()> {
        self.inner.forget_audit_of(tenant, before_ms)
    }
}
