//! Counts that operators watch. Plain atomics: how they are published is the server's affair.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

/// A number that only grows.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Adds one.
    pub(super) fn up(&self) {
        self.add(1);
    }

    /// Adds `n`.
    pub(super) fn add(&self, n: u64) {
        self.0.fetch_add(n, Relaxed);
    }

    /// The count so far.
    pub fn get(&self) -> u64 {
        self.0.load(Relaxed)
    }
}

/// A number that goes up and down.
#[derive(Debug, Default)]
pub struct Gauge(AtomicI64);

impl Gauge {
    pub(super) fn add(&self, n: i64) {
        self.0.fetch_add(n, Relaxed);
    }

    /// Counts one more until the guard is dropped.
    pub(super) fn hold(&self) -> Held<'_> {
        self.add(1);
        Held(self)
    }

    /// The number now.
    pub fn get(&self) -> i64 {
        self.0.load(Relaxed)
    }
}

/// One unit of a [`Gauge`].
#[derive(Debug)]
pub(super) struct Held<'a>(&'a Gauge);

impl Drop for Held<'_> {
    fn drop(&mut self) {
        self.0.add(-1);
    }
}

/// How durations are spread.
#[derive(Debug, Default)]
pub struct Histogram {
    buckets: [AtomicU64; Self::BOUNDS_MS.len() + 1],
    sum_us: AtomicU64,
}

impl Histogram {
    /// Upper bounds of the buckets in milliseconds; one more bucket holds what is above the last.
    pub const BOUNDS_MS: [f64; 15] = [
        0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 33.0, 66.0, 125.0, 250.0, 500.0, 1000.0, 4000.0, 15000.0, 60000.0,
    ];

    pub(super) fn record(&self, elapsed: Duration) {
        let ms = elapsed.as_secs_f64() * 1e3;
        let at = Self::BOUNDS_MS
            .iter()
            .position(|&bound| ms <= bound)
            .unwrap_or(Self::BOUNDS_MS.len());
        self.buckets[at].fetch_add(1, Relaxed);
        self.sum_us
            .fetch_add(u64::try_from(elapsed.as_micros()).unwrap_or(u64::MAX), Relaxed);
    }

    /// Durations in each bucket (not cumulative), the last one above all bounds.
    pub fn buckets(&self) -> [u64; Self::BOUNDS_MS.len() + 1] {
        std::array::from_fn(|k| self.buckets[k].load(Relaxed))
    }

    /// Durations recorded.
    pub fn count(&self) -> u64 {
        self.buckets().iter().sum()
    }

    /// Their sum in milliseconds.
    pub fn sum_ms(&self) -> f64 {
        self.sum_us.load(Relaxed) as f64 / 1e3
    }
}

/// What happened since the start, and how things are now.
#[derive(Debug, Default)]
pub struct Metrics {
    /// Sessions held.
    pub sessions: Gauge,
    /// Sessions created.
    pub sessions_created: Counter,
    /// Sessions that expired unused.
    pub sessions_expired: Counter,
    /// Sessions lost to a defect.
    pub sessions_failed: Counter,
    /// Bytes held, and reserved for builds under way.
    pub bytes: Gauge,
    /// Streams open.
    pub streams: Gauge,
    /// Poses that arrived on streams and solve calls.
    pub poses_received: Counter,
    /// Poses solved.
    pub poses_solved: Counter,
    /// Poses skipped because a newer one came.
    pub poses_superseded: Counter,
    /// Poses refused.
    pub poses_refused: Counter,
    /// Commits stored, those of calls and of streams.
    pub commits: Counter,
    /// Frames handed to a transport.
    pub frames_sent: Counter,
    /// Bytes of the data of their parts.
    pub frame_bytes: Counter,
    /// Solver cycles.
    pub cycles: Counter,
    /// Time from the start of a solve to its result.
    pub solve: Histogram,
    /// Time that work waited for a compute slot.
    pub queue: Histogram,
    /// Time that builds of sessions took.
    pub build: Histogram,
    /// Pieces of work being computed.
    pub pool_busy: Gauge,
    /// Pieces of work waiting for a compute slot.
    pub pool_waiting: Gauge,
    /// Calls refused for want of capacity.
    pub refused: Counter,
    /// Work given up because its caller had gone or its time was over.
    pub cancelled: Counter,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_fall_into_the_bucket_of_their_upper_bound() {
        let histogram = Histogram::default();
        for ms in [0, 1, 3, 4, 90_000] {
            histogram.record(Duration::from_millis(ms));
        }
        let buckets = histogram.buckets();
        assert_eq!((buckets[0], buckets[1], buckets[2], buckets[3]), (1, 1, 0, 2));
        assert_eq!((buckets[15], histogram.count()), (1, 5));
        assert!((histogram.sum_ms() - 90_008.0).abs() < 1e-9);
    }

    #[test]
    fn a_held_gauge_falls_back() {
        let gauge = Gauge::default();
        let held = (gauge.hold(), gauge.hold());
        assert_eq!(gauge.get(), 2);
        drop(held);
        assert_eq!(gauge.get(), 0);
    }
}
