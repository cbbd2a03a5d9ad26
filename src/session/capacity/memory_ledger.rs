//! The one ledger of bytes: what sessions hold, and what is on its way in, under work or on its way out.

use crate::session::capacity::memory_use::MemoryUse;
use crate::session::metrics::Metrics;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};

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
    /// Changed under the ledger's lock only.
    bytes: AtomicU64,
}

impl MemoryLedger {
    pub(in crate::session) fn new(total: u64, metrics: Arc<Metrics>) -> Arc<Self> {
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
        *self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes nothing yet, for who will say by [`MemoryReservation::resize`] what is held.
    pub fn reserve_later(self: &Arc<Self>, what: MemoryUse) -> MemoryReservation {
        MemoryReservation {
            ledger: Arc::clone(self),
            what,
            bytes: AtomicU64::new(0),
        }
    }

    /// Takes `wanted` bytes, or what there is if that is at least `least`.
    pub fn reserve(self: &Arc<Self>, what: MemoryUse, least: u64, wanted: u64) -> Option<MemoryReservation> {
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        let free = self.total.saturating_sub(*used);
        let bytes = wanted.min(free);
        if bytes < least.min(wanted) {
            return None;
        }
        *used = used.saturating_add(bytes);
        self.metrics.held_bytes(what).inc_by(signed(bytes));
        drop(used);
        Some(MemoryReservation {
            ledger: Arc::clone(self),
            what,
            bytes: AtomicU64::new(bytes),
        })
    }
}

impl MemoryReservation {
    /// Bytes reserved.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Relaxed)
    }

    /// Bytes that this reservation could grow to.
    pub fn room(&self) -> u64 {
        let used = self.ledger.used.lock().unwrap_or_else(PoisonError::into_inner);
        self.ledger.total.saturating_sub(used.saturating_sub(self.bytes()))
    }

    /// Sees to it that at least `bytes` are reserved. False, and nothing changes, when there is no room for them.
    pub fn grow_to(&self, bytes: u64) -> bool {
        let mut used = self.ledger.used.lock().unwrap_or_else(PoisonError::into_inner);
        let more = bytes.saturating_sub(self.bytes());
        if more == 0 {
            return true;
        }
        if used.saturating_add(more) > self.ledger.total {
            return false;
        }
        *used += more;
        self.bytes.fetch_add(more, Relaxed);
        self.ledger.metrics.held_bytes(self.what).inc_by(signed(more));
        true
    }

    /// Says how many bytes are really held. They are counted even where they break the budget; false tells that they do.
    pub fn resize(&self, bytes: u64) -> bool {
        let mut used = self.ledger.used.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.bytes.swap(bytes, Relaxed);
        *used = used.saturating_sub(before).saturating_add(bytes);
        let gauge = self.ledger.metrics.held_bytes(self.what);
        gauge.inc_by(signed(bytes) - signed(before));
        *used <= self.ledger.total
    }
}

impl Drop for MemoryReservation {
    fn drop(&mut self) {
        self.resize(0);
    }
}

fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_taken_is_gone_until_it_is_given_back() {
        let metrics = Arc::new(Metrics::default());
        let ledger = MemoryLedger::new(100, Arc::clone(&metrics));
        let reserve = |least, wanted| ledger.reserve(MemoryUse::Sessions, least, wanted);
        let held = || metrics.held_bytes(MemoryUse::Sessions).get();
        let first = reserve(10, 60).expect("60 of 100");
        let second = reserve(10, 60).expect("the 40 that are left");
        assert!(reserve(10, 60).is_none(), "nothing is left");
        assert!(reserve(10, 0).is_some(), "nothing is wanted");
        assert_eq!((ledger.used(), first.room()), (100, 60));
        assert!(!first.resize(70), "counted, but above the budget");
        assert_eq!((ledger.used(), held()), (110, 110));
        drop(second);
        assert!(first.resize(100));
        drop(first);
        assert_eq!((ledger.used(), held()), (0, 0));
    }

    #[test]
    fn work_grows_as_far_as_there_is_room_and_never_beyond() {
        let ledger = MemoryLedger::new(100, Arc::default());
        let session = ledger.reserve(MemoryUse::Sessions, 40, 40).expect("40 of 100");
        let answer = ledger.reserve(MemoryUse::Answers, 20, 20).expect("20 more");
        assert!(session.grow_to(30) && session.bytes() == 40, "it has more already");
        assert!(session.grow_to(80) && session.bytes() == 80);
        assert!(!session.grow_to(81) && session.bytes() == 80, "20 are an answer's");
        assert_eq!(ledger.used(), 100);
        drop(answer);
        assert!(session.grow_to(100));
    }
}
