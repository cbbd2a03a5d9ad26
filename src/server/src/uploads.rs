//! Bytes of uploads that are being received: they belong to no session yet, so they are counted here.

use super::config::ServerConfig;
use pliant_session::{Error, ErrorCode, Manager, MemoryLedger, MemoryReservation, MemoryUse, TenantAccount};
use prometheus_client::metrics::counter::Counter;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::Instant;

/// What all uploads under way may hold together.
#[derive(Debug, Clone)]
pub(super) struct UploadBudget {
    used: Arc<AtomicU64>,
    total: u64,
    each: u64,
    ledger: Arc<MemoryLedger>,
    /// Calls rejected for lack of capacity.
    refused: Counter,
}

/// What one upload holds; given back when dropped.
#[derive(Debug)]
pub(super) struct HeldUpload {
    budget: UploadBudget,
    bytes: u64,
    /// The same bytes in the ledger of everything that is held.
    counted: MemoryReservation,
    /// Who sends it.
    sender: Option<Arc<TenantAccount>>,
    /// Whose uploads it counts for.
    account: Option<Arc<TenantAccount>>,
}

impl UploadBudget {
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

    /// Starts the body of a request, which counts for its tenant.
    pub fn hold(&self, account: Option<&Arc<TenantAccount>>) -> HeldUpload {
        HeldUpload {
            budget: self.clone(),
            bytes: 0,
            counted: self.ledger.reserve_later(MemoryUse::Uploads, None),
            sender: account.cloned(),
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

impl HeldUpload {
    /// The same, counted as an upload of a tenant.
    #[must_use]
    pub fn of_tenant(mut self, account: Arc<TenantAccount>) -> Self {
        self.account = Some(account);
        self
    }

    /// Takes `bytes` more.
    ///
    /// # Errors
    /// Too large when this upload passes its limit; exhausted when all uploads together do, or those of the tenant pass its quota,
    /// or the memory of the server is full.
    pub fn grow(&mut self, bytes: usize) -> Result<(), Error> {
        let bytes = bytes as u64;
        let mine = self.bytes.saturating_add(bytes);
        if mine > self.budget.each {
            return Err(self.budget.too_large(mine));
        }
        if let Some(account) = &self.account {
            account.take_upload(bytes, mine)?;
        }
        self.sender.as_ref().map_or(Ok(()), |sender| sender.take_body(bytes))?;
        let before = self.budget.used.fetch_add(bytes, Ordering::Relaxed);
        self.bytes = mine;
        let total = self.budget.total;
        let refuse = |text: String| {
            self.budget.refused.inc();
            Err(Error::exhausted(format!("{text}; try again later"), 2))
        };
        if before.saturating_add(bytes) > total {
            return refuse(format!(
                "the bodies of requests that are being received fill the {total} bytes that they may hold together"
            ));
        }
        match self.counted.grow_to(mine) {
            Ok(()) => Ok(()),
            Err(shortage) => refuse(shortage.to_string()),
        }
    }
}

impl Drop for HeldUpload {
    fn drop(&mut self) {
        self.budget.used.fetch_sub(self.bytes, Ordering::Relaxed);
        self.sender.iter().for_each(|sender| sender.end_body(self.bytes));
    }
}

/// How fast an upload must come. A peer that sends a byte now and then holds a connection and memory as one that sends nothing
/// does; so besides the longest silence there is a slowest mean rate, and a longest time for all of it.
#[derive(Debug)]
pub(super) struct UploadPace {
    begun: Instant,
    last_received: Instant,
    bytes: u64,
    silence: Duration,
    rate: u64,
    whole: Duration,
}

impl UploadPace {
    /// Of an upload that begins now.
    pub fn new(config: &ServerConfig) -> Self {
        let now = Instant::now();
        Self {
            begun: now,
            last_received: now,
            bytes: 0,
            silence: config.keepalive_interval + config.keepalive_timeout,
            rate: config.upload_rate,
            whole: config.upload_deadline,
        }
    }

    /// Counts bytes that came.
    pub fn take(&mut self, bytes: usize) {
        self.last_received = Instant::now();
        self.bytes = self.bytes.saturating_add(bytes as u64);
    }

    /// When more must have come, at the latest.
    pub fn due(&self) -> Instant {
        (self.last_received + self.silence)
            .min(self.too_slow_at())
            .min(self.begun + self.whole)
    }

    /// The error when nothing more came in time.
    pub fn late(&self) -> Error {
        let silent_at = self.last_received + self.silence;
        let text = if self.due() == silent_at {
            format!("nothing more came for {}", humantime::format_duration(self.silence))
        } else if self.due() == self.begun + self.whole {
            let whole = humantime::format_duration(self.whole);
            format!("it took longer than {whole}; the key upload_deadline allows more")
        } else {
            format!(
                "it came slower than {} bytes a second; the key upload_rate allows less",
                self.rate
            )
        };
        Error::new(ErrorCode::DeadlineExceeded, format!("the upload is given up: {text}"))
    }

    /// When the mean rate falls below the slowest. The longest silence is granted on top, so that a slow beginning is none.
    fn too_slow_at(&self) -> Instant {
        let granted = Duration::from_secs_f64(self.bytes as f64 / self.rate.max(1) as f64);
        self.begun + self.silence + granted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_session::SessionConfig;

    #[test]
    fn one_upload_and_all_together_are_bounded_and_given_back() {
        let manager = Manager::new(SessionConfig::default()).expect("a manager");
        let budget = UploadBudget::new(100, 150, &manager);
        assert_eq!(budget.announce(101).unwrap_err().http_status(), 413);
        let mut first = budget.hold(None);
        first.grow(100).unwrap();
        assert_eq!(first.grow(1).unwrap_err().http_status(), 413);
        let mut second = budget.hold(None);
        second.grow(50).unwrap();
        assert_eq!(second.grow(1).unwrap_err().http_status(), 429);
        assert_eq!(manager.ledger().used(), 150);
        drop((first, second));
        assert_eq!(manager.ledger().used(), 0);
        assert_eq!(budget.used.load(Ordering::Relaxed), 0);
    }
}
