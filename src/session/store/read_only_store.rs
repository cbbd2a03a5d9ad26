//! A store that is looked at: what a session wants to note on its way is not noted, and nothing can be changed.

use super::session_store::{
    ListedSession, LoggedKey, NewCommit, NewSession, SessionStore, StoreError, Stored, StoredCommit, StoredSession,
    UsedSession,
};
use crate::session::answers::Tenant;
use crate::session::audit::audit_entry::AuditEntry;
use bytes::Bytes;
use std::sync::Arc;

/// A store that is looked at.
#[derive(Debug, Clone)]
pub struct ReadOnlyStore(pub Arc<dyn SessionStore>);

fn refused<'a, T: Send + 'a>() -> Stored<'a, T> {
    Box::pin(async { Err(StoreError::Refused("the store is only looked at".into())) })
}

fn not_noted<'a>() -> Stored<'a, ()> {
    Box::pin(async { Ok(()) })
}

impl SessionStore for ReadOnlyStore {
    fn build(&self) -> String {
        self.0.build()
    }

    fn create(&self, _: NewSession) -> Stored<'_, ()> {
        refused()
    }

    fn append(&self, _: NewCommit) -> Stored<'_, ()> {
        refused()
    }

    fn keep_shape(&self, _: String, _: u64, _: Bytes) -> Stored<'_, ()> {
        not_noted()
    }

    fn adopt(&self, _: String, _: String, _: Vec<(u64, String)>) -> Stored<'_, ()> {
        not_noted()
    }

    fn load(&self, tenant: Tenant, id: String) -> Stored<'_, Option<StoredSession>> {
        self.0.load(tenant, id)
    }

    fn commit(&self, session: String, sequence: u64) -> Stored<'_, Option<StoredCommit>> {
        self.0.commit(session, sequence)
    }

    fn holds(&self, tenant: Tenant, id: String) -> Stored<'_, bool> {
        self.0.holds(tenant, id)
    }

    fn list(&self, tenant: Tenant, after: u64, most: usize) -> Stored<'_, Vec<(u64, Option<ListedSession>)>> {
        self.0.list(tenant, after, most)
    }

    fn object(&self, name: String) -> Stored<'_, Bytes> {
        self.0.object(name)
    }

    fn delete(&self, _: AuditEntry) -> Stored<'_, ()> {
        refused()
    }

    fn note_use(&self, _: Vec<UsedSession>) -> Stored<'_, ()> {
        not_noted()
    }

    fn expired(&self, _: u64) -> Stored<'_, Vec<(Tenant, String)>> {
        // What is looked at does not go.
        Box::pin(async { Ok(Vec::new()) })
    }

    fn sessions_by_tenant(&self) -> Stored<'_, Vec<(Tenant, u64)>> {
        self.0.sessions_by_tenant()
    }

    fn stored_bytes(&self, tenant: Tenant) -> Stored<'_, u64> {
        self.0.stored_bytes(tenant)
    }

    fn keys(&self) -> Stored<'_, Vec<LoggedKey>> {
        Box::pin(async { Ok(Vec::new()) })
    }

    fn forget_keys(&self, _: u64) -> Stored<'_, ()> {
        not_noted()
    }

    fn highest_number(&self) -> Stored<'_, u64> {
        self.0.highest_number()
    }

    fn audit(&self, _: AuditEntry) -> Stored<'_, ()> {
        not_noted()
    }

    fn audited_tenants(&self) -> Stored<'_, Vec<Tenant>> {
        self.0.audited_tenants()
    }

    fn forget_audit_of(&self, _: Tenant, _: u64) -> Stored<'_, ()> {
        not_noted()
    }
}
