//! How long a session outlives its last use.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, SystemTime};
use tokio::time::Instant;

/// The shortest time to live that a session may ask for.
pub const MIN_TTL: Duration = Duration::from_secs(1);

/// The time of a session's last use, renewed by every call.
#[derive(Debug)]
pub(in crate::session) struct SessionLease {
    opened: Instant,
    last_use_ms: AtomicU64,
    ttl: Duration,
}

impl SessionLease {
    /// Used now.
    pub fn new(ttl: Duration) -> Self {
        Self {
            opened: Instant::now(),
            last_use_ms: AtomicU64::new(0),
            ttl,
        }
    }

    /// Used now.
    pub fn renew(&self) {
        let now = u64::try_from(self.opened.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.last_use_ms.fetch_max(now, Relaxed);
    }

    /// When it was used last.
    pub fn last_use(&self) -> Instant {
        self.opened + Duration::from_millis(self.last_use_ms.load(Relaxed))
    }

    /// When it ends if nothing uses it until then.
    pub fn end(&self) -> Instant {
        // Rounded up, so that it never ends early.
        self.opened + Duration::from_millis(self.last_use_ms.load(Relaxed) + 1) + self.ttl
    }

    /// Whether it has ended.
    pub fn expired(&self) -> bool {
        Instant::now() >= self.end()
    }

    /// When it ends, on the calendar (RFC 3339, UTC).
    pub fn end_text(&self) -> String {
        let left = self.end().saturating_duration_since(Instant::now());
        let end = SystemTime::now().checked_add(left).unwrap_or(SystemTime::UNIX_EPOCH);
        humantime::format_rfc3339_millis(end).to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn use_renews_it() {
        let lease = SessionLease::new(Duration::ZERO);
        let first = lease.end();
        tokio::time::sleep(Duration::from_millis(5)).await;
        assert!(lease.expired());
        lease.renew();
        assert!(lease.end() > first);
        let long = SessionLease::new(Duration::from_secs(3600));
        assert!(!long.expired());
        let text = long.end_text();
        let left = humantime::parse_rfc3339(&text)
            .expect("RFC 3339")
            .duration_since(SystemTime::now());
        assert!(left.is_ok_and(|left| left <= Duration::from_secs(3601)), "{text}");
    }
}
