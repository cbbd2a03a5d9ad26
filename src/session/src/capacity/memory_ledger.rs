//! The one ledger of bytes: what sessions hold, and what is on its way in, under work or on its way out. What a tenant asked for counts
//! for its quota of memory too.

use crate::capacity::memory_use::MemoryUse;
use crate::metrics::Metrics;
use crate::quota::tenant_account::TenantAccount;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A number of bytes, handed out in reservations.
#[derive(Debug)]
pub struct MemoryLedger {
    total: u64,
    used: Mutex<u64>,
    metrics: Arc<Metrics>,
}

/// Bytes that one session, upload or answer holds, or that work on it is expected to need. Given back when dropped.
#[derive(Debug)]
pub struct MemoryReservation {
    ledger: Arc<MemoryLedger>,
    what: MemoryUse,
    /// Whose quota they count for.
    account: Option<Arc<TenantAccount>>,
    /// Changed under the ledger's lock only.
    bytes: AtomicU64,
}

/// Whose memory has no room for what is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MemoryShortage {
    /// That of all tenants: so many bytes of so many are reserved.
    Server {
        /// Bytes that are reserved.
        used: u64,
        /// Bytes that may be.
        total: u64,
    },
    /// The quota of the tenant: so many bytes of so many are reserved.
    Tenant {
        /// Bytes that are reserved.
        used: u64,
        /// Bytes that may be.
        total: u64,
    },
}

impl fmt::Display for MemoryShortage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (whose, used, total) = match self {
            Self::Server { used, total } => ("the memory of the server", used, total),
            Self::Tenant { used, total } => ("your quota of memory", used, total),
        };
        write!(f, "{whose} is full: {used} of {total} bytes are in use")
    }
}

impl MemoryLedger {
    pub(crate) fn new(total: u64, metrics: Arc<Metrics>) -> Arc<Self> {
        Arc::new(Self {
            total,
            used: Mutex::new(0),
            metrics,
        })
    }

    /// Bytes that may be held.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Bytes held and reserved.
    pub fn used(&self) -> u64 {
        *self.lock()
    }

    fn lock(&self) -> MutexGuard<'_, u64> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes nothing yet: [`MemoryReservation::resize`] and [`MemoryReservation::grow_to`] do. The bytes count for the quota of
    /// `account`, if there is one.
    pub fn reserve_later(self: &Arc<Self>, what: MemoryUse, account: Option<&Arc<TenantAccount>>) -> MemoryReservation {
        MemoryReservation {
            ledger: Arc::clone(self),
            what,
            account: account.cloned(),
            bytes: AtomicU64::new(0),
        }
    }

    /// Takes `wanted` bytes, or what there is if that is at least `least`. They count for the quota of `account`, if there is one.
    ///
    /// # Errors
    /// Whose memory has fewer than `least` bytes left.
    pub fn reserve(
        self: &Arc<Self>,
        what: MemoryUse,
        account: Option<&Arc<TenantAccount>>,
        least: u64,
        wanted: u64,
    ) -> Result<MemoryReservation, MemoryShortage> {
        let reservation = self.reserve_later(what, account);
        let mut used = self.lock();
        let bytes = wanted.min(reservation.room_beside(*used));
        if bytes < least.min(wanted) {
            return Err(reservation.shortage_of(least, *used));
        }
        reservation.set(&mut used, bytes);
        drop(used);
        Ok(reservation)
    }
}

impl MemoryReservation {
    /// Bytes reserved.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Relaxed)
    }

    /// Bytes that this reservation could grow to.
    pub fn room(&self) -> u64 {
        self.room_beside(*self.ledger.lock())
    }

    /// The same, while so many bytes are reserved in all.
    fn room_beside(&self, used: u64) -> u64 {
        let own = self.bytes();
        let of_server = self.ledger.total.saturating_sub(used.saturating_sub(own));
        let of_tenant = self.account.as_ref().map_or(u64::MAX, |a| a.memory_room());
        of_server.min(of_tenant.saturating_add(own))
    }

    /// Whose memory has no room for so many bytes.
    pub fn shortage(&self, bytes: u64) -> MemoryShortage {
        self.shortage_of(bytes, *self.ledger.lock())
    }

    fn shortage_of(&self, bytes: u64, used: u64) -> MemoryShortage {
        let more = bytes.saturating_sub(self.bytes());
        match self.account.as_ref().and_then(|a| a.memory_shortage(more)) {
            Some((used, total)) => MemoryShortage::Tenant { used, total },
            None => MemoryShortage::Server {
                used,
                total: self.ledger.total,
            },
        }
    }

    /// Sees to it that at least `bytes` are reserved.
    ///
    /// # Errors
    /// Whose memory has no room for them; nothing changes then.
    pub fn grow_to(&self, bytes: u64) -> Result<(), MemoryShortage> {
        let mut used = self.ledger.lock();
        if bytes > self.bytes() {
            if bytes > self.room_beside(*used) {
                return Err(self.shortage_of(bytes, *used));
            }
            self.set(&mut used, bytes);
        }
        Ok(())
    }

    /// Says how many bytes are really held. They are counted even where they break the budget.
    ///
    /// # Errors
    /// Whose budget they break.
    pub fn resize(&self, bytes: u64) -> Result<(), MemoryShortage> {
        let mut used = self.ledger.lock();
        let room = self.room_beside(*used);
        self.set(&mut used, bytes);
        if bytes > room {
            return Err(self.shortage_of(bytes, *used));
        }
        Ok(())
    }

    /// Counts so many bytes from now on, of which `used` is the sum with all others.
    fn set(&self, used: &mut u64, bytes: u64) {
        let before = self.bytes.swap(bytes, Relaxed);
        *used = used.saturating_sub(before).saturating_add(bytes);
        if let Some(account) = &self.account {
            account.count_memory(before, bytes);
        }
        let gauge = self.ledger.metrics.held_bytes(self.what);
        gauge.inc_by(signed(bytes) - signed(before));
    }
}

impl Drop for MemoryReservation {
    fn drop(&mut self) {
        let mut used = self.ledger.lock();
        self.set(&mut used, 0);
    }
}

fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::answers::Tenant;
    use crate::quota::tenant_account::TenantAccounts;
    use crate::quota::tenant_quota::{TenantQuota, TenantQuotas};
    use prometheus_client::metrics::counter::Counter;

    #[test]
    fn what_is_taken_is_gone_until_it_is_given_back() {
        let metrics = Arc::new(Metrics::default());
        let ledger = MemoryLedger::new(100, Arc::clone(&metrics));
        let reserve = |least, wanted| ledger.reserve(MemoryUse::Sessions, None, least, wanted);
        let held = || metrics.held_bytes(MemoryUse::Sessions).get();
        let first = reserve(10, 60).expect("60 of 100");
        let second = reserve(10, 60).expect("the 40 that are left");
        let full = MemoryShortage::Server { used: 100, total: 100 };
        assert_eq!(reserve(10, 60).err(), Some(full), "nothing is left");
        assert!(reserve(10, 0).is_ok(), "nothing is wanted");
        assert_eq!((ledger.used(), first.room()), (100, 60));
        assert!(first.resize(70).is_err(), "counted, but above the budget");
        assert_eq!((ledger.used(), held()), (110, 110));
        drop(second);
        assert_eq!(first.resize(100), Ok(()));
        drop(first);
        assert_eq!((ledger.used(), held()), (0, 0));
    }

    #[test]
    fn work_grows_as_far_as_there_is_room_and_never_beyond() {
        let ledger = MemoryLedger::new(100, Arc::default());
        let session = ledger.reserve(MemoryUse::Sessions, None, 40, 40).expect("40 of 100");
        let answer = ledger.reserve(MemoryUse::Answers, None, 20, 20).expect("20 more");
        assert!(
            session.grow_to(30).is_ok() && session.bytes() == 40,
            "it has more already"
        );
        assert!(session.grow_to(80).is_ok() && session.bytes() == 80);
        assert!(
            session.grow_to(81).is_err() && session.bytes() == 80,
            "20 are an answer's"
        );
        assert_eq!(ledger.used(), 100);
        drop(answer);
        assert_eq!(session.grow_to(100), Ok(()));
    }

    #[test]
    fn a_tenant_fills_its_own_quota_and_no_other_one() {
        let quotas = TenantQuotas {
            default: TenantQuota {
                memory_bytes: Some(60),
                ..TenantQuota::default()
            },
            ..TenantQuotas::default()
        };
        let accounts = TenantAccounts::new(quotas, Counter::default());
        let [one, other] = ["one", "other"].map(|name| accounts.of(&Tenant(name.into())).expect("an account"));
        let ledger = MemoryLedger::new(100, Arc::default());
        let reserve = |account, bytes| ledger.reserve(MemoryUse::Answers, Some(account), bytes, bytes);
        let first = reserve(&one, 50).expect("50 of 60");
        let full = MemoryShortage::Tenant { used: 50, total: 60 };
        assert_eq!(reserve(&one, 20).err(), Some(full));
        assert_eq!(first.room(), 60);
        let second = reserve(&other, 40).expect("40 of another's 60");
        assert_eq!(first.room(), 60, "of the 100");
        let full = MemoryShortage::Server { used: 90, total: 100 };
        assert_eq!(second.grow_to(55), Err(full));
        assert_eq!(second.resize(70), Err(MemoryShortage::Tenant { used: 70, total: 60 }));
        drop((first, second));
        assert_eq!((ledger.used(), one.memory_room(), other.memory_room()), (0, 60, 60));
    }
}
