//! Who calls: what a tenant may use, and what is noted of what it does.

use crate::session::answers::Tenant;
use crate::session::audit::audit_entry::{AuditEntry, AuditedAction};
use crate::session::audit::audit_trail::note;
use crate::session::calls::manager::Manager;
use crate::session::capacity::session_lease::MIN_TTL;
use crate::session::error::Error;
use crate::session::quota::tenant_account::{QuotaReport, TenantAccount};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

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
    pub(in crate::session) fn audit_entry(&self, tenant: &Tenant, what: AuditedAction, id: &str) -> AuditEntry {
        AuditEntry {
            tenant: tenant.clone(),
            who: Arc::clone(&self.who),
            what,
            session: id.to_owned(),
        }
    }

    /// Notes what the caller does.
    pub(in crate::session) async fn note(&self, tenant: &Tenant, what: AuditedAction, id: &str) {
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
    pub async fn quotas_left(&self, tenant: &Tenant) -> Result<QuotaReport, Error> {
        let account = self.account(tenant)?;
        let stored = match (&self.shared.store, account.stored_quota()) {
            (Some(store), Some(_)) => store.stored_bytes(tenant.clone()).await?,
            _ => 0,
        };
        Ok(account.report(stored))
    }
}
