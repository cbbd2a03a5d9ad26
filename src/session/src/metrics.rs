//! Counts that operators watch. The server publishes them; here they are only counted.

use crate::capacity::memory_use::MemoryUse;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Registry, Unit};
use std::collections::BTreeMap;
use std::time::Duration;

/// Upper bounds of the buckets of durations, in seconds; one more bucket holds what is above the last.
const DURATION_BOUNDS: [f64; 15] = [
    0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.033, 0.066, 0.125, 0.25, 0.5, 1.0, 4.0, 15.0, 60.0,
];

/// What a piece of work is counted under; the names are those of the code, so their number is bounded.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct WorkLabels {
    work: &'static str,
}

/// What a stage of a build is counted under.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct StageLabels {
    stage: String,
}

type Durations<L> = Family<L, Histogram, fn() -> Histogram>;

fn durations() -> Histogram {
    Histogram::new(DURATION_BOUNDS)
}

/// What happened since the start, and how things are now.
#[derive(Debug)]
pub struct Metrics {
    /// Sessions held.
    pub sessions: Gauge,
    /// Sessions created.
    pub sessions_created: Counter,
    /// Sessions that expired unused.
    pub sessions_expired: Counter,
    /// Stored sessions that came back into memory.
    pub sessions_reopened: Counter,
    /// Calls that were sent to the node that has their session.
    pub sent_elsewhere: Counter,
    /// Sessions that other nodes have taken from this one.
    pub sessions_lost: Counter,
    /// Commits that could not be stored.
    pub store_failures: Counter,
    /// Sessions lost to a defect.
    pub sessions_failed: Counter,
    /// Bytes held and reserved, by what they are held for.
    bytes_by_use: Family<[(&'static str, &'static str); 1], Gauge>,
    /// The gauges of that family, in the order of [`MemoryUse::ALL`].
    bytes: [Gauge; MemoryUse::ALL.len()],
    /// Streams open.
    pub streams: Gauge,
    /// Animations under way.
    pub animations: Gauge,
    /// Poses that arrived on streams and solve calls.
    pub poses_received: Counter,
    /// Poses solved.
    pub poses_solved: Counter,
    /// Poses skipped because a newer one came.
    pub poses_superseded: Counter,
    /// Poses rejected.
    pub poses_refused: Counter,
    /// Commits stored, those of calls and of streams.
    pub commits: Counter,
    /// Frames handed to a transport.
    pub frames_sent: Counter,
    /// Bytes of the data of their parts.
    pub frame_bytes: Counter,
    /// Solver cycles.
    pub cycles: Counter,
    /// Seconds from the start of a solve to its result.
    pub solve: Histogram,
    /// Seconds that work waited for a compute slot.
    pub queue: Histogram,
    /// Seconds that builds of sessions took.
    pub build: Histogram,
    /// Seconds of pieces of work, by kind.
    work: Durations<WorkLabels>,
    /// Seconds of the stages of builds and edits.
    stages: Durations<StageLabels>,
    /// Pieces of work being computed.
    pub pool_busy: Gauge,
    /// Pieces of work waiting for a compute slot.
    pub pool_waiting: Gauge,
    /// Calls rejected because capacity ran out.
    pub refused: Counter,
    /// Work aborted because its caller disconnected or its time ran out.
    pub cancelled: Counter,
}

impl Default for Metrics {
    fn default() -> Self {
        let bytes_by_use = Family::<[(&str, &str); 1], Gauge>::default();
        Self {
            bytes: MemoryUse::ALL.map(|what| bytes_by_use.get_or_create_owned(&[("use", what.name())])),
            bytes_by_use,
            sessions: Gauge::default(),
            sessions_created: Counter::default(),
            sessions_expired: Counter::default(),
            sessions_reopened: Counter::default(),
            sent_elsewhere: Counter::default(),
            sessions_lost: Counter::default(),
            store_failures: Counter::default(),
            sessions_failed: Counter::default(),
            streams: Gauge::default(),
            animations: Gauge::default(),
            poses_received: Counter::default(),
            poses_solved: Counter::default(),
            poses_superseded: Counter::default(),
            poses_refused: Counter::default(),
            commits: Counter::default(),
            frames_sent: Counter::default(),
            frame_bytes: Counter::default(),
            cycles: Counter::default(),
            solve: durations(),
            queue: durations(),
            build: durations(),
            work: Family::new_with_constructor(durations),
            stages: Family::new_with_constructor(durations),
            pool_busy: Gauge::default(),
            pool_waiting: Gauge::default(),
            refused: Counter::default(),
            cancelled: Counter::default(),
        }
    }
}

impl Metrics {
    /// Bytes held and reserved for one use.
    pub fn held_bytes(&self, what: MemoryUse) -> &Gauge {
        &self.bytes[what as usize]
    }

    /// Counts a piece of work of a kind.
    pub(crate) fn observe_work(&self, work: &'static str, took: Duration) {
        let histogram = self.work.get_or_create(&WorkLabels { work });
        histogram.observe(took.as_secs_f64());
    }

    /// Counts the stages of a build, by name, in milliseconds.
    pub(crate) fn observe_stages(&self, stages: &BTreeMap<String, f64>) {
        for (stage, ms) in stages {
            let stage = stage.clone();
            self.stages.get_or_create(&StageLabels { stage }).observe(ms / 1e3);
        }
    }

    /// What is counted, under the names that operators know.
    fn counters(&self) -> [(&'static str, &'static str, &Counter); 17] {
        [
            ("sessions_created", "Sessions created", &self.sessions_created),
            (
                "sessions_expired",
                "Sessions that expired unused",
                &self.sessions_expired,
            ),
            ("sessions_failed", "Sessions lost to a defect", &self.sessions_failed),
            (
                "sessions_reopened",
                "Stored sessions that came back into memory",
                &self.sessions_reopened,
            ),
            (
                "sessions_lost",
                "Sessions that other nodes have taken from this one",
                &self.sessions_lost,
            ),
            (
                "sent_elsewhere",
                "Calls that were sent to the node that has their session",
                &self.sent_elsewhere,
            ),
            (
                "store_failures",
                "Commits and sessions that could not be stored",
                &self.store_failures,
            ),
            ("poses_received", "Poses that arrived", &self.poses_received),
            ("poses_solved", "Poses solved", &self.poses_solved),
            (
                "poses_superseded",
                "Poses skipped because a newer one came",
                &self.poses_superseded,
            ),
            ("poses_refused", "Poses rejected", &self.poses_refused),
            ("commits", "Commits stored", &self.commits),
            ("frames_sent", "Frames handed to a transport", &self.frames_sent),
            ("frame_bytes", "Bytes of the data of frames", &self.frame_bytes),
            ("solver_cycles", "Solver cycles", &self.cycles),
            ("refused", "Calls rejected because capacity ran out", &self.refused),
            (
                "cancelled",
                "Work aborted because its caller disconnected or its time ran out",
                &self.cancelled,
            ),
        ]
    }

    /// Adds every count to a registry, under the names that operators know. `memory_bytes` is what all sessions together
    /// may hold.
    pub fn register(&self, memory_bytes: u64, registry: &mut Registry) {
        let limit = Gauge::<i64>::default();
        limit.set(i64::try_from(memory_bytes).unwrap_or(i64::MAX));
        let gauges: [(&str, &str, &Gauge); 7] = [
            ("sessions", "Sessions held", &self.sessions),
            (
                "session_bytes",
                "Bytes held by sessions and builds under way",
                self.held_bytes(MemoryUse::Sessions),
            ),
            ("streams", "Deform streams open", &self.streams),
            ("animations", "Animations under way", &self.animations),
            ("pool_busy", "Pieces of work being computed", &self.pool_busy),
            (
                "pool_waiting",
                "Pieces of work waiting for a compute slot",
                &self.pool_waiting,
            ),
            (
                "session_bytes_limit",
                "Bytes that sessions, uploads and answers may hold together",
                &limit,
            ),
        ];
        for (name, help, gauge) in gauges {
            registry.register(name, help, gauge.clone());
        }
        registry.register("memory_bytes", "Bytes held, by use", self.bytes_by_use.clone());
        for (name, help, counter) in self.counters() {
            registry.register(name, help, counter.clone());
        }
        let durations: [(&str, &str, &Histogram); 3] = [
            ("solve", "Time from the start of a solve to its result", &self.solve),
            ("queue", "Time that work waited for a compute slot", &self.queue),
            ("build", "Time that builds of sessions took", &self.build),
        ];
        for (name, help, durations) in durations {
            registry.register_with_unit(name, help, Unit::Seconds, durations.clone());
        }
        registry.register_with_unit(
            "work",
            "Time that pieces of work took, by kind",
            Unit::Seconds,
            self.work.clone(),
        );
        registry.register_with_unit(
            "stage",
            "Time that stages of builds and edits took",
            Unit::Seconds,
            self.stages.clone(),
        );
    }
}

/// One unit of a gauge, taken back when this is dropped.
#[derive(Debug)]
pub(super) struct GaugeUnit(Gauge);

impl GaugeUnit {
    /// Counts one more.
    pub fn add_to(gauge: &Gauge) -> Self {
        gauge.inc();
        Self(gauge.clone())
    }
}

impl Drop for GaugeUnit {
    fn drop(&mut self) {
        self.0.dec();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_of_a_gauge_falls_back() {
        let gauge = Gauge::default();
        let held = (GaugeUnit::add_to(&gauge), GaugeUnit::add_to(&gauge));
        assert_eq!(gauge.get(), 2);
        drop(held);
        assert_eq!(gauge.get(), 0);
    }
}
