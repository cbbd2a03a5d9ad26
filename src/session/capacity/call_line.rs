//! The calls that wait on one session, which serves them one after the other.

use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::time::Duration;

/// How many calls a session was given, and how many of them its task has begun.
#[derive(Debug, Default)]
pub(in crate::session) struct CallLine {
    given: AtomicU64,
    begun: AtomicU64,
    /// Nanoseconds that a call takes, in the mean of the last few; 0 before the first has ended.
    mean: AtomicU64,
}

impl CallLine {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_waits_is_counted_until_it_is_served() {
        let line = CallLine::default();
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
