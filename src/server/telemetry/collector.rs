//! Publishes the counts of the session floor, which knows nothing of how they are published.

use crate::session::{Counter, Gauge, Histogram, Manager, Metrics};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric as _};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::registry::Unit;
use std::fmt;

/// Reads a manager's counts on every scrape.
pub(super) struct Sessions(pub Manager);

impl fmt::Debug for Sessions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Sessions")
    }
}

impl Collector for Sessions {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let m: &Metrics = self.0.metrics();
        let gauges: [(&str, &str, &Gauge); 5] = [
            ("sessions", "Sessions held.", &m.sessions),
            (
                "session_bytes",
                "Bytes held by sessions and builds under way.",
                &m.bytes,
            ),
            ("streams", "Deform streams open.", &m.streams),
            ("pool_busy", "Pieces of work being computed.", &m.pool_busy),
            (
                "pool_waiting",
                "Pieces of work waiting for a compute slot.",
                &m.pool_waiting,
            ),
        ];
        for (name, help, gauge) in gauges {
            let gauge = ConstGauge::new(gauge.get());
            gauge.encode(encoder.encode_descriptor(name, help, None, MetricType::Gauge)?)?;
        }
        let limit = ConstGauge::new(i64::try_from(self.0.config().memory_bytes).unwrap_or(i64::MAX));
        let help = "Bytes that all sessions together may hold.";
        limit.encode(encoder.encode_descriptor("session_bytes_limit", help, None, MetricType::Gauge)?)?;
        let counters: [(&str, &str, &Counter); 13] = [
            ("sessions_created", "Sessions created.", &m.sessions_created),
            ("sessions_expired", "Sessions that expired unused.", &m.sessions_expired),
            ("sessions_failed", "Sessions lost to a defect.", &m.sessions_failed),
            ("poses_received", "Poses that arrived.", &m.poses_received),
            ("poses_solved", "Poses solved.", &m.poses_solved),
            (
                "poses_superseded",
                "Poses skipped because a newer one came.",
                &m.poses_superseded,
            ),
            ("poses_refused", "Poses refused.", &m.poses_refused),
            ("commits", "Commits stored.", &m.commits),
            ("frames_sent", "Frames handed to a transport.", &m.frames_sent),
            ("frame_bytes", "Bytes of the data of frames.", &m.frame_bytes),
            ("solver_cycles", "Solver cycles.", &m.cycles),
            ("refused", "Calls refused for want of capacity.", &m.refused),
            (
                "cancelled",
                "Work given up because its caller had gone or its time was over.",
                &m.cancelled,
            ),
        ];
        for (name, help, counter) in counters {
            let counter = ConstCounter::new(counter.get());
            counter.encode(encoder.encode_descriptor(name, help, None, MetricType::Counter)?)?;
        }
        let histograms: [(&str, &str, &Histogram); 3] = [
            ("solve", "Time from the start of a solve to its result.", &m.solve),
            ("queue", "Time that work waited for a compute slot.", &m.queue),
            ("build", "Time that builds of sessions took.", &m.build),
        ];
        for (name, help, histogram) in histograms {
            let counts = histogram.buckets();
            let bounds = Histogram::BOUNDS_MS.iter().map(|ms| ms / 1e3).chain([f64::INFINITY]);
            let buckets: Vec<(f64, u64)> = bounds.zip(counts).collect();
            let mut metric = encoder.encode_descriptor(name, help, Some(&Unit::Seconds), MetricType::Histogram)?;
            let none = None::<
                &std::collections::HashMap<
                    usize,
                    prometheus_client::metrics::exemplar::Exemplar<[(&str, &str); 0], f64>,
                >,
            >;
            metric.encode_histogram(histogram.sum_ms() / 1e3, counts.iter().sum(), &buckets, none)?;
        }
        Ok(())
    }
}
