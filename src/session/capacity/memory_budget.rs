//! The bytes that all sessions together may hold.

use crate::session::metrics::Metrics;
use std::sync::{Arc, Mutex, PoisonError};

/// A number of bytes, handed out in reservations.
#[derive(Debug)]
pub(in crate::session) struct MemoryBudget {
    total: u64,
    used: Mutex<u64>,
    metrics: Arc<Metrics>,
}

/// Bytes that one session holds, or one build is expected to need. Given back when dropped.
#[derive(Debug)]
pub(in crate::session) struct MemoryReservation {
    budget: Arc<MemoryBudget>,
    bytes: u64,
}

impl MemoryBudget {
    pub fn new(total: u64, metrics: Arc<Metrics>) -> Arc<Self> {
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

    /// Takes `wanted` bytes, or what there is if that is at least `least`.
    pub fn reserve(self: &Arc<Self>, least: u64, wanted: u64) -> Option<MemoryReservation> {
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        let free = self.total.saturating_sub(*used);
        let bytes = wanted.min(free);
        if bytes < least.min(wanted) {
            return None;
        }
        *used = used.saturating_add(bytes);
        self.metrics.bytes.inc_by(signed(bytes));
        drop(used);
        Some(MemoryReservation {
            budget: Arc::clone(self),
            bytes,
        })
    }
}

impl MemoryReservation {
    /// Bytes that this reservation could grow to.
    pub fn room(&self) -> u64 {
        let used = self.budget.used.lock().unwrap_or_else(PoisonError::into_inner);
        self.budget.total.saturating_sub(used.saturating_sub(self.bytes))
    }

    /// Says how many bytes are really held. They are counted even where they break the budget; false tells that they do.
    pub fn resize(&mut self, bytes: u64) -> bool {
        let mut used = self.budget.used.lock().unwrap_or_else(PoisonError::into_inner);
        *used = used.saturating_sub(self.bytes).saturating_add(bytes);
        self.budget.metrics.bytes.inc_by(signed(bytes) - signed(self.bytes));
        self.bytes = bytes;
        *used <= self.budget.total
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
        let budget = MemoryBudget::new(100, Arc::clone(&metrics));
        let mut first = budget.reserve(10, 60).expect("60 of 100");
        let second = budget.reserve(10, 60).expect("the 40 that are left");
        assert!(budget.reserve(10, 60).is_none(), "nothing is left");
        assert!(budget.reserve(10, 0).is_some(), "nothing is wanted");
        assert_eq!((budget.used(), first.room()), (100, 60));
        assert!(!first.resize(70), "counted, but above the budget");
        assert_eq!((budget.used(), metrics.bytes.get()), (110, 110));
        drop(second);
        assert!(first.resize(100));
        drop(first);
        assert_eq!((budget.used(), metrics.bytes.get()), (0, 0));
    }
}
