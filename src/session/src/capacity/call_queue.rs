//! The calls that wait on one session, which serves them one after the other.
//!
//! Counts open calls, so that a server that stops can wait for the last one.
//!
//! How long a session outlives its last use.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::{Relaxed, SeqCst};
use std::time::{Duration, SystemTime};
use tokio::sync::watch;
use tokio::time::Instant;

/// How many calls a session was given, and how many of them its task has begun.
#[derive(Debug, Default)]
pub(crate) struct CallQueue {
    given: AtomicU64,
    begun: AtomicU64,
    /// Nanoseconds that a call takes, in the mean of the last few; 0 before the first has ended.
    mean: AtomicU64,
}

impl CallQueue {
    /// A call was given; its place in the line, counted from the session's first call on.
    pub fn join(&self) -> u64 {
        self.given.fetch_add(1, SeqCst)
    }

    /// The task begins with the next call.
    pub fn begin(&self) {
        self.begun.fetch_add(1, SeqCst);
    }

    /// A call was served in so much time.
    pub fn note_service(&self, took: Duration) {
        let took = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        let before = self.mean.load(SeqCst);
        // The task alone notes.
        let mean = if before == 0 { took } else { before / 4 * 3 + took / 4 };
        self.mean.store(mean.max(1), SeqCst);
    }

    /// How long so many calls are expected to take.
    pub fn expected(&self, calls: u64) -> Duration {
        Duration::from_nanos(self.mean.load(SeqCst).saturating_mul(calls))
    }

    /// How many calls wait before the one in that place, the one that is being served among them.
    pub fn ahead_of(&self, place: u64) -> u64 {
        (place + 1).saturating_sub(self.begun.load(SeqCst))
    }

    /// How many would be ahead of one that came now.
    pub fn waiting(&self) -> u64 {
        self.ahead_of(self.given.load(SeqCst))
    }
}

/// Counts calls and streams under way.
#[derive(Debug)]
pub(crate) struct CallGate(watch::Sender<usize>);

/// One call or stream under way.
#[derive(Debug)]
pub(crate) struct CallGuard(watch::Sender<usize>);

impl CallGate {
    pub fn new() -> Self {
        Self(watch::Sender::new(0))
    }

    /// Counts one more until the guard is dropped.
    pub fn enter(&self) -> CallGuard {
        self.0.send_modify(|n| *n += 1);
        CallGuard(self.0.clone())
    }

    /// Waits until none is open.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn empty(&self) {
        // Fails only when the sender is gone, and it is `self`.
        let _ = self.0.subscribe().wait_for(|&n| n == 0).await;
    }
}

impl Drop for CallGuard {
    fn drop(&mut self) {
        self.0.send_modify(|n| *n = n.saturating_sub(1));
    }
}

/// The shortest time to live that a session may ask for.
pub const MIN_TTL: Duration = Duration::from_secs(1);

/// The time of a session's last use, renewed by every call.
#[derive(Debug)]
pub(crate) struct SessionLease {
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

    #[test]
    fn who_waits_is_counted_until_it_is_served() {
        let line = CallQueue::default();
        let [first, second] = [line.join(), line.join()];
        line.begin();
        assert_eq!((line.ahead_of(first), line.ahead_of(second)), (0, 1));
        line.begin();
        assert_eq!(line.ahead_of(second), 0);
        assert_eq!(line.expected(5), Duration::ZERO);
        line.note_service(Duration::from_secs(1));
        line.note_service(Duration::from_secs(5));
        assert_eq!(line.expected(3), Duration::from_secs(6));
    }
}

#[cfg(test)]
mod call_gate_tests {
    use super::*;

    #[tokio::test]
    async fn empty_once_the_last_has_left() {
        let gate = CallGate::new();
        gate.empty().await;
        let (a, b) = (gate.enter(), gate.enter());
        drop(a);
        let wait = gate.empty();
        tokio::pin!(wait);
        assert!(futures::poll!(wait.as_mut()).is_pending());
        drop(b);
        wait.await;
    }
}

#[cfg(test)]
mod session_lease_tests {
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
