//! What one tenant uses, against what it may use.
//!
//! The accounts of all tenants.

use crate::answers::{Tenant, WorkOwner};
use crate::error::{Error, ErrorCode};
use crate::quota::tenant_quota::TokenBucket;
use crate::quota::tenant_quota::{TenantQuota, TenantQuotas};
use pliant_wire::pb;
use prometheus_client::metrics::counter::Counter;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::{Relaxed, SeqCst};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What one tenant uses. All its sessions, streams and uploads share it.
#[derive(Debug)]
pub struct TenantAccount {
    tenant: Tenant,
    quota: TenantQuota,
    sessions: AtomicU64,
    streams: AtomicU64,
    resident: AtomicU64,
    /// Bytes of bodies of requests that are being received.
    bodies: AtomicU64,
    /// Bytes on their way into the store and those that have arrived or never did, both since the start.
    announced: AtomicU64,
    settled: AtomicU64,
    uploads: Option<TokenBucket>,
    work: Option<TokenBucket>,
    /// Calls that exceeded the capacity, of all tenants.
    refused: Counter,
}

impl TenantAccount {
    pub(super) fn new(tenant: Tenant, quota: TenantQuota, refused: Counter) -> Self {
        let now = Instant::now();
        Self {
            tenant,
            sessions: AtomicU64::new(0),
            streams: AtomicU64::new(0),
            resident: AtomicU64::new(0),
            bodies: AtomicU64::new(0),
            announced: AtomicU64::new(0),
            settled: AtomicU64::new(0),
            uploads: quota.upload_bytes_per_minute.map(|n| TokenBucket::new(n as f64, now)),
            work: quota.solve_seconds_per_minute.map(|n| TokenBucket::new(n, now)),
            quota,
            refused,
        }
    }

    /// Whose it is.
    pub fn tenant(&self) -> &Tenant {
        &self.tenant
    }

    /// What it may use.
    pub(crate) fn quota(&self) -> &TenantQuota {
        &self.quota
    }

    /// The quotas of the tenant, with `stored` bytes in the store.
    pub fn report(&self, stored: u64) -> pb::Quotas {
        let now = Instant::now();
        let count = |allowed: Option<u64>, used: &AtomicU64| {
            allowed.map(|allowed| pb::QuotaState {
                allowed: allowed as f64,
                left: allowed.saturating_sub(used.load(Relaxed)) as f64,
            })
        };
        let rate = |bucket: &Option<TokenBucket>| {
            bucket.as_ref().map(|bucket| pb::QuotaState {
                allowed: bucket.a_minute(),
                left: bucket.left(now).max(0.0),
            })
        };
        pb::Quotas {
            sessions: count(self.quota.sessions, &self.sessions),
            memory_bytes: count(self.quota.memory_bytes, &self.resident),
            stored_bytes: count(self.quota.stored_bytes, &AtomicU64::new(stored)),
            upload_bytes_per_minute: rate(&self.uploads),
            solve_seconds_per_minute: rate(&self.work),
            streams: count(self.quota.streams, &self.streams),
        }
    }

    /// Whether it counts no use, so that dropping and rebuilding it has no effect.
    pub(super) fn is_idle(&self) -> bool {
        let now = Instant::now();
        let is_full = |bucket: &Option<TokenBucket>| bucket.as_ref().is_none_or(|b| b.left(now) >= b.a_minute());
        let uses_none = [&self.sessions, &self.streams, &self.resident, &self.bodies];
        uses_none.iter().all(|used| used.load(Relaxed) == 0) && is_full(&self.uploads) && is_full(&self.work)
    }

    /// Takes the place of one session.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED`; `next` says after how long one of the tenant's sessions may end.
    pub(crate) fn take_session(self: &Arc<Self>, next: impl FnOnce() -> Duration) -> Result<TenantSession, Error> {
        if !add_below(&self.sessions, self.quota.sessions) {
            let most = self.quota.sessions.unwrap_or_default();
            let text = format!(
                "{most} of your sessions are open, your quota allows no more; delete one or wait for one to expire"
            );
            return Err(later(text, next()));
        }
        Ok(TenantSession {
            account: Arc::clone(self),
            outlived: false,
            storing: None,
        })
    }

    /// The place of a session that is counted already and comes back into memory.
    pub(crate) fn place_again(self: &Arc<Self>) -> TenantSession {
        TenantSession {
            account: Arc::clone(self),
            outlived: true,
            storing: None,
        }
    }

    /// Counts sessions that are in the store.
    pub(crate) fn count_stored(&self, sessions: u64) {
        self.sessions.fetch_add(sessions, Relaxed);
    }

    /// Sets how many sessions are in the store.
    pub(crate) fn recount(&self, sessions: u64) {
        self.sessions.store(sessions, Relaxed);
    }

    /// A session is gone, from the store too.
    pub(crate) fn uncount_session(&self) {
        let less = |n: u64| Some(n.saturating_sub(1));
        let _ = self.sessions.fetch_update(Relaxed, Relaxed, less);
    }

    /// Bytes that may be reserved besides; more than can be where there is no quota.
    pub(crate) fn memory_room(&self) -> u64 {
        let used = self.resident.load(Relaxed);
        self.quota
            .memory_bytes
            .map_or(u64::MAX, |most| most.saturating_sub(used))
    }

    /// Where so many more bytes are more than its quota has room for: how many are reserved, and how many may be.
    pub(crate) fn memory_shortage(&self, more: u64) -> Option<(u64, u64)> {
        let (used, total) = (self.resident.load(Relaxed), self.quota.memory_bytes?);
        (used.saturating_add(more) > total).then_some((used, total))
    }

    /// Counts `now` bytes where `before` were counted, even where that is more than the quota.
    pub(crate) fn count_memory(&self, before: u64, now: u64) {
        let changed = |held: u64| Some(held.saturating_sub(before).saturating_add(now));
        let _ = self.resident.fetch_update(Relaxed, Relaxed, changed);
    }

    /// Counts `more` bytes of the body of a request, until [`TenantAccount::end_body`]. All bodies that it sends at a time may hold as
    /// many bytes as its sessions may, beside them: idle sessions leave memory for a new one only when its model has come.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED`.
    pub fn take_body(&self, more: u64) -> Result<(), Error> {
        let most = self.quota.memory_bytes.unwrap_or(u64::MAX);
        let grown = |held: u64| held.checked_add(more).filter(|held| *held <= most);
        let taken = self.bodies.fetch_update(Relaxed, Relaxed, grown);
        taken.map(|_| ()).map_err(|held| {
            self.refused.inc();
            let text = format!(
                "the bodies of your requests hold {held} bytes, {more} more have come and your quota of memory allows {most}"
            );
            later(text, Duration::from_secs(2))
        })
    }

    /// So many bytes of bodies are gone.
    pub fn end_body(&self, bytes: u64) {
        self.bodies.fetch_sub(bytes, Relaxed);
    }

    /// The most bytes that its sessions may hold in the store.
    pub(crate) fn stored_quota(&self) -> Option<u64> {
        self.quota.stored_bytes
    }

    /// Bytes whose way into the store has ended by now; to be asked before the store is asked what it holds.
    pub(crate) fn settled_bytes(&self) -> u64 {
        self.settled.load(SeqCst)
    }

    /// Announces `more` bytes for the store, which held `used` after `settled` was asked for. Those that others announced meanwhile
    /// count as well; `None` where they are too many together.
    pub(crate) fn announce_stored(self: &Arc<Self>, more: u64, used: u64, settled: u64) -> Option<BytesToStore> {
        let most = self.quota.stored_bytes.unwrap_or(u64::MAX);
        let fits = |announced: u64| {
            let under_way = announced.wrapping_sub(settled);
            let sum = used.saturating_add(under_way).saturating_add(more);
            (sum <= most).then(|| announced.wrapping_add(more))
        };
        let announced = self.announced.fetch_update(SeqCst, SeqCst, fits);
        announced.ok().map(|_| BytesToStore {
            account: Arc::clone(self),
            bytes: more,
        })
    }

    /// The most bytes that its sessions and answers may hold together.
    pub(crate) fn memory_quota(&self) -> Option<u64> {
        self.quota.memory_bytes
    }

    /// Takes the place of one stream.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED`.
    pub(crate) fn take_stream(self: &Arc<Self>) -> Result<TenantStream, Error> {
        if !add_below(&self.streams, self.quota.streams) {
            let most = self.quota.streams.unwrap_or_default();
            let text = format!("{most} of your streams are open, your quota allows no more; close one");
            return Err(later(text, Duration::from_secs(1)));
        }
        Ok(TenantStream(Arc::clone(self)))
    }

    /// Counts `more` bytes of an upload of which `whole` are known of by now.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` with the time after which so much may be sent; too large where it never may.
    pub fn take_upload(&self, more: u64, whole: u64) -> Result<(), Error> {
        let Some(bucket) = &self.uploads else { return Ok(()) };
        let most = bucket.a_minute();
        if whole as f64 > most {
            let text = format!("the upload has {whole} bytes or more, your quota allows {most} a minute");
            return Err(Error::new(ErrorCode::TooLarge, text));
        }
        bucket.take(more as f64, Instant::now()).map_err(|wait| {
            self.refused.inc();
            let text = format!("your quota of {most} uploaded bytes a minute is used up");
            later(text, wait)
        })
    }

    /// Whether an upload of so many bytes could be taken now; none is counted yet.
    ///
    /// # Errors
    /// As [`TenantAccount::take_upload`].
    pub fn check_upload(&self, bytes: u64) -> Result<(), Error> {
        self.take_upload(bytes, bytes)?;
        if let Some(bucket) = &self.uploads {
            bucket.charge(-(bytes as f64), Instant::now());
        }
        Ok(())
    }

    /// Asks whether work may begin.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` with the time after which it may.
    pub(crate) fn check_work(&self) -> Result<(), Error> {
        let Some(bucket) = &self.work else { return Ok(()) };
        bucket.check(Instant::now()).map_err(|wait| {
            self.refused.inc();
            let text = format!(
                "your quota of {} seconds of computing a minute is used up",
                bucket.a_minute()
            );
            later(text, wait)
        })
    }

    /// Counts work that was done.
    pub(crate) fn charge_work(&self, time: Duration) {
        if let Some(bucket) = &self.work {
            bucket.charge(time.as_secs_f64(), Instant::now());
        }
    }
}

/// Adds one where that is allowed.
fn add_below(count: &AtomicU64, most: Option<u64>) -> bool {
    let most = most.unwrap_or(u64::MAX);
    count
        .fetch_update(Relaxed, Relaxed, |n| (n < most).then(|| n + 1))
        .is_ok()
}

/// Refused, until a time that is rounded up.
fn later(text: String, wait: Duration) -> Error {
    let seconds = wait.as_secs().saturating_add(u64::from(wait.subsec_nanos() > 0));
    Error::exhausted(text, u32::try_from(seconds).unwrap_or(u32::MAX).max(1))
}

/// Bytes on their way into the store. They count until this is dropped, when they have arrived or never will.
#[derive(Debug)]
pub(crate) struct BytesToStore {
    account: Arc<TenantAccount>,
    bytes: u64,
}

impl Drop for BytesToStore {
    fn drop(&mut self) {
        self.account.settled.fetch_add(self.bytes, SeqCst);
    }
}

/// The place of one session of a tenant. Given back when dropped.
#[derive(Debug)]
pub(crate) struct TenantSession {
    account: Arc<TenantAccount>,
    /// The session is in the store too: it stays counted until it is deleted there.
    outlived: bool,
    /// What is to be stored of it.
    storing: Option<BytesToStore>,
}

impl TenantSession {
    /// Whose it is.
    pub fn tenant(&self) -> &Tenant {
        &self.account.tenant
    }

    /// Whose work the opening of a session is.
    pub fn work_owner(&self) -> WorkOwner {
        WorkOwner {
            tenant: self.account.tenant.clone(),
            session: String::new(),
        }
    }

    /// What all sessions of that tenant share.
    pub fn account(&self) -> &Arc<TenantAccount> {
        &self.account
    }

    /// The same place, with what is to be stored of the session.
    pub fn with_stored(mut self, storing: Option<BytesToStore>) -> Self {
        self.storing = storing;
        self
    }

    /// The session is in the store and counted until [`TenantAccount::uncount_session`].
    pub fn outlive(&mut self) {
        self.outlived = true;
        self.storing = None;
    }
}

impl Drop for TenantSession {
    fn drop(&mut self) {
        if !self.outlived {
            self.account.uncount_session();
        }
    }
}

/// The place of one stream of a tenant. Given back when dropped.
#[derive(Debug)]
pub(crate) struct TenantStream(Arc<TenantAccount>);

impl TenantStream {
    /// Counts work that was done for it.
    pub fn charge_work(&self, time: Duration) {
        self.0.charge_work(time);
    }
}

impl Drop for TenantStream {
    fn drop(&mut self) {
        self.0.streams.fetch_sub(1, Relaxed);
    }
}

/// Most tenants whose use is counted at a time: those that use nothing are forgotten first.
pub const MOST_TENANTS: usize = 100_000;

/// The accounts of the tenants that use something, and of some more.
#[derive(Debug)]
pub(crate) struct TenantAccounts {
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
mod tenant_accounts_tests {
    use super::*;
    use crate::quota::tenant_quota::TenantQuota;
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
            let reported = account.report(0);
            assert_eq!(
                reported.sessions.map(|s| (s.allowed, s.left)),
                Some((f64::from(sessions), 0.0))
            );
            assert_eq!(reported.streams.map(|s| (s.allowed, s.left)), Some((2.0, 2.0)));
            drop(taken);
            assert_eq!(account.report(0).sessions.map(|s| s.left), Some(f64::from(sessions)));
        }
    }
}
