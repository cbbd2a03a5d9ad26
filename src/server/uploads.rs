//! Bytes of uploads that are on their way: they belong to no session yet, so they are counted here.

use crate::session::{Error, ErrorCode, Manager, MemoryLedger, MemoryReservation, MemoryUse, TenantAccount};
use prometheus_client::metrics::counter::Counter;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What all uploads under way may hold together.
#[derive(Debug, Clone)]
pub(super) struct Budget {
    used: Arc<AtomicU64>,
    total: u64,
    each: u64,
    ledger: Arc<MemoryLedger>,
    /// Calls that were refused for want of capacity.
    refused: Counter,
}

/// What one upload holds; given back when dropped.
#[derive(Debug)]
pub(super) struct Held {
    budget: Budget,
    bytes: u64,
    /// The same bytes in the ledger of everything that is held.
    counted: Option<MemoryReservation>,
    /// Whose it is.
    account: Option<Arc<TenantAccount>>,
}

impl Budget {
    /// `each` bytes for one upload, `total` for all together, and for them and all else what the ledger has left.
    pub fn new(each: u64, total: u64, manager: &Manager) -> Self {
        Self {
            used: Arc::default(),
            total: total.max(each),
            each,
            ledger: Arc::clone(manager.ledger()),
            refused: manager.metrics().refused.clone(),
        }
    }

    /// Starts an upload.
    pub fn hold(&self) -> Held {
        Held {
            budget: self.clone(),
            bytes: 0,
            counted: self.ledger.reserve(MemoryUse::Uploads, 0, 0),
            account: None,
        }
    }

    /// Refuses an announced length before any of it is read.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` as too large.
    pub fn announce(&self, bytes: u64) -> Result<(), Error> {
        if bytes > self.each {
            Err(self.too_large(bytes))
        } else {
            Ok(())
        }
    }

    fn too_large(&self, bytes: u64) -> Error {
        Error::new(
            ErrorCode::TooLarge,
            format!(
                "the upload has {bytes} bytes or more, at most {} are allowed",
                self.each
            ),
        )
    }
}

impl Held {
    /// The same, counted as the upload of a tenant.
    #[must_use]
    pub fn of_tenant(mut self, account: Arc<TenantAccount>) -> Self {
        self.account = Some(account);
        self
    }

    /// Takes `bytes` more.
    ///
    /// # Errors
    /// Too large when this upload passes its limit; exhausted when all uploads together do.
    pub fn grow(&mut self, bytes: usize) -> Result<(), Error> {
        let bytes = bytes as u64;
        let mine = self.bytes.saturating_add(bytes);
        if mine > self.budget.each {
            return Err(self.budget.too_large(mine));
        }
        if let Some(account) = &self.account {
            account.take_upload(bytes, mine)?;
        }
        let before = self.budget.used.fetch_add(bytes, Ordering::Relaxed);
        self.bytes = mine;
        let has_room = self.counted.as_ref().is_none_or(|counted| counted.grow_to(mine));
        if !has_room || before.saturating_add(bytes) > self.budget.total {
            self.budget.refused.inc();
            return Err(Error::exhausted("too many uploads are under way", 2));
        }
        Ok(())
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.budget.used.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::SessionConfig;

    #[test]
    fn one_upload_and_all_together_are_bounded_and_given_back() {
        let manager = Manager::new(SessionConfig::default()).expect("a manager");
        let budget = Budget::new(100, 150, &manager);
        assert_eq!(budget.announce(101).unwrap_err().http_status(), 413);
        let mut first = budget.hold();
        first.grow(100).unwrap();
        assert_eq!(first.grow(1).unwrap_err().http_status(), 413);
        let mut second = budget.hold();
        second.grow(50).unwrap();
        assert_eq!(second.grow(1).unwrap_err().http_status(), 429);
        assert_eq!(manager.ledger().used(), 151, "and the byte that was one too many");
        drop((first, second));
        assert_eq!(manager.ledger().used(), 0);
        assert_eq!(budget.used.load(Ordering::Relaxed), 0);
    }
}
