//! Counts that operators watch. The server publishes them; here they are only counted.

use crate::capacity::memory_use::MemoryUse;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Metric, Registry, Unit};
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
    /// Every count, under the name that operators know.
    registry: Registry,
    /// Bytes that sessions, uploads and answers may hold together.
    pub(crate) bytes_limit: Gauge,
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
    /// Bytes held and reserved, by what they are held for, in the order of [`MemoryUse::ALL`].
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

/// A count that operators know by this name.
fn named<M: Metric + Clone + Default>(registry: &mut Registry, name: &str, help: &str) -> M {
    let metric = M::default();
    registry.register(name, help, metric.clone());
    metric
}

/// A histogram of seconds, or a family of them, that operators know by this name.
fn timed<M: Metric + Clone>(registry: &mut Registry, name: &str, help: &str, metric: M) -> M {
    registry.register_with_unit(name, help, Unit::Seconds, metric.clone());
    metric
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("pliant");
        let r = &mut registry;
        let bytes_by_use = Family::<[(&str, &str); 1], Gauge>::default();
        let bytes = MemoryUse::ALL.map(|what| bytes_by_use.get_or_create_owned(&[("use", what.name())]));
        let by_work: Durations<WorkLabels> = Family::new_with_constructor(durations);
        let by_stage: Durations<StageLabels> = Family::new_with_constructor(durations);
        let sessions = named(r, "sessions", "Sessions held");
        r.register(
            "session_bytes",
            "Bytes held by sessions and builds under way",
            bytes[MemoryUse::Sessions as usize].clone(),
        );
        r.register("memory_bytes", "Bytes held, by use", bytes_by_use);
        Self {
            sessions,
            streams: named(r, "streams", "Deform streams open"),
            animations: named(r, "animations", "Animations under way"),
            pool_busy: named(r, "pool_busy", "Pieces of work being computed"),
            pool_waiting: named(r, "pool_waiting", "Pieces of work waiting for a compute slot"),
            bytes_limit: named(
                r,
                "session_bytes_limit",
                "Bytes that sessions, uploads and answers may hold together",
            ),
            bytes,
            sessions_created: named(r, "sessions_created", "Sessions created"),
            sessions_expired: named(r, "sessions_expired", "Sessions that expired unused"),
            sessions_failed: named(r, "sessions_failed", "Sessions lost to a defect"),
            sessions_reopened: named(r, "sessions_reopened", "Stored sessions that came back into memory"),
            sessions_lost: named(r, "sessions_lost", "Sessions that other nodes have taken from this one"),
            sent_elsewhere: named(
                r,
                "sent_elsewhere",
                "Calls that were sent to the node that has their session",
            ),
            store_failures: named(r, "store_failures", "Commits and sessions that could not be stored"),
            poses_received: named(r, "poses_received", "Poses that arrived"),
            poses_solved: named(r, "poses_solved", "Poses solved"),
            poses_superseded: named(r, "poses_superseded", "Poses skipped because a newer one came"),
            poses_refused: named(r, "poses_refused", "Poses rejected"),
            commits: named(r, "commits", "Commits stored"),
            frames_sent: named(r, "frames_sent", "Frames handed to a transport"),
            frame_bytes: named(r, "frame_bytes", "Bytes of the data of frames"),
            cycles: named(r, "solver_cycles", "Solver cycles"),
            refused: named(r, "refused", "Calls rejected because capacity ran out"),
            cancelled: named(
                r,
                "cancelled",
                "Work aborted because its caller disconnected or its time ran out",
            ),
            solve: timed(r, "solve", "Time from the start of a solve to its result", durations()),
            queue: timed(r, "queue", "Time that work waited for a compute slot", durations()),
            build: timed(r, "build", "Time that builds of sessions took", durations()),
            work: timed(r, "work", "Time that pieces of work took, by kind", by_work),
            stages: timed(r, "stage", "Time that stages of builds and edits took", by_stage),
            registry,
        }
    }
}

impl Metrics {
    /// Every count, under the names that operators know.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

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
