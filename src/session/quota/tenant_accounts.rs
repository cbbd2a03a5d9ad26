//! The accounts of all tenants.

use crate::session::answers::Tenant;
use crate::session::error::Error;
use crate::session::quota::tenant_account::TenantAccount;
use crate::session::quota::tenant_quota::TenantQuotas;
use prometheus_client::metrics::counter::Counter;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Most tenants whose use is counted at a time: those that use nothing are forgotten first.
pub const MOST_TENANTS: usize = 100_000;

/// The accounts of the tenants that use something, and of some more.
#[derive(Debug)]
pub(in crate::session) struct TenantAccounts {
    quotas: TenantQuotas,
    open: Mutex<BTreeMap<Tenant, Arc<TenantAccount>>>,
    /// Calls that exceeded the capacity.
    refused: Counter,
}

impl TenantAccounts {
    /// Accounts without use.
    pub fn new(quotas: TenantQuotas, refused: Counter) -> Self {
        Self {
            quotas,
            refused,
            open: Mutex::default(),
        }
    }

    /// The account of a tenant.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where too many other tenants use something.
    pub fn of(&self, tenant: &Tenant) -> Result<Arc<TenantAccount>, Error> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(account) = open.get(tenant) {
            return Ok(Arc::clone(account));
        }
        if open.len() >= MOST_TENANTS {
            open.retain(|_, account| Arc::strong_count(account) > 1 || !account.is_idle());
            if open.len() >= MOST_TENANTS {
                return Err(Error::exhausted("too many tenants use this server", 60));
            }
        }
        let account = Arc::new(TenantAccount::new(
            tenant.clone(),
            self.quotas.of(tenant),
            self.refused.clone(),
        ));
        open.insert(tenant.clone(), Arc::clone(&account));
        Ok(account)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::quota::tenant_quota::TenantQuota;
    use std::time::Duration;

    fn named(name: &str) -> Tenant {
        Tenant(name.into())
    }

    #[test]
    fn tenants_that_use_nothing_are_forgotten_when_there_are_many() {
        let accounts = TenantAccounts::new(TenantQuotas::default(), Counter::default());
        let kept = accounts.of(&named("kept")).unwrap();
        let session = kept.take_session(|| Duration::ZERO).unwrap();
        drop(kept);
        for k in 0..2 * MOST_TENANTS {
            accounts.of(&named(&k.to_string())).unwrap();
        }
        assert!(accounts.open.lock().unwrap().len() <= MOST_TENANTS);
        assert!(Arc::ptr_eq(session.account(), &accounts.of(&named("kept")).unwrap()));
    }

    #[test]
    fn a_named_tenant_has_its_own_quota_over_the_default() {
        let quotas = TenantQuotas {
            default: TenantQuota {
                sessions: Some(1),
                streams: Some(2),
                ..TenantQuota::default()
            },
            named: BTreeMap::from([(
                "large".into(),
                TenantQuota {
                    sessions: Some(3),
                    ..TenantQuota::default()
                },
            )]),
        };
        let accounts = TenantAccounts::new(quotas, Counter::default());
        for (name, sessions) in [("large", 3), ("other", 1)] {
            let account = accounts.of(&named(name)).unwrap();
            let taken: Vec<_> = (0..sessions)
                .map(|_| account.take_session(|| Duration::ZERO).unwrap())
                .collect();
            let refused = account.take_session(|| Duration::from_millis(1500)).unwrap_err();
            assert_eq!((refused.http_status(), refused.retry_after_s), (429, Some(2)), "{name}");
            let told = account.report(0);
            assert_eq!(
                told.sessions.map(|s| (s.allowed, s.left)),
                Some((f64::from(sessions), 0.0))
            );
            assert_eq!(told.streams.map(|s| (s.allowed, s.left)), Some((2.0, 2.0)));
            drop(taken);
            assert_eq!(account.report(0).sessions.map(|s| s.left), Some(f64::from(sessions)));
        }
    }
}
