//! What operators see: log lines and counts. Nothing here decides anything.
//!
//! Log lines read as sentences and carry dotted fields (`session.id`, `duration_ms`). Each call has one line at info (target
//! `pliant::access`), failures of the server are errors, and nothing is logged per frame.

mod log;
mod observe;
mod traces;

pub use log::is_json as logs_json;
pub use log::start as start_log;
pub(super) use observe::{Recorder, grpc_code};
pub use traces::TraceExport;

use crate::session::Manager;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};
use std::sync::Arc;

/// What a finished call is counted under. Routes and methods come from fixed lists, so their number is bounded.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub(super) struct Call {
    transport: &'static str,
    route: Arc<str>,
    code: Arc<str>,
}

/// What durations are counted under.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub(super) struct RouteLabels {
    transport: &'static str,
    route: Arc<str>,
}

/// Counts of the server. Cloning shares them.
#[derive(Clone)]
pub(super) struct Telemetry {
    registry: Arc<Registry>,
    calls: Family<Call, Counter>,
    seconds: Family<RouteLabels, Histogram, fn() -> Histogram>,
    in_flight: Gauge,
    /// Connections open.
    pub connections: Gauge,
    /// Connections turned away because too many were open.
    pub connections_refused: Counter,
    /// WebSockets open.
    pub sockets: Gauge,
}

fn seconds_histogram() -> Histogram {
    Histogram::new([
        0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0,
    ])
}

impl Telemetry {
    /// Counts that also report those of `manager`.
    pub fn new(manager: &Manager) -> Self {
        let mut registry = Registry::with_prefix("pliant");
        let calls = Family::<Call, Counter>::default();
        let seconds = Family::<RouteLabels, Histogram, fn() -> Histogram>::new_with_constructor(seconds_histogram);
        let (in_flight, connections, sockets) = (Gauge::default(), Gauge::default(), Gauge::default());
        let connections_refused = Counter::default();
        registry.register(
            "build",
            "Version of this server",
            Info::new([("version", env!("CARGO_PKG_VERSION"))]),
        );
        registry.register(
            "requests",
            "Calls finished, by transport, route and status",
            calls.clone(),
        );
        registry.register_with_unit(
            "request",
            "Time from the head of a call to the end of its answer",
            Unit::Seconds,
            seconds.clone(),
        );
        registry.register("requests_in_flight", "Calls being answered", in_flight.clone());
        registry.register("connections", "Connections open", connections.clone());
        registry.register(
            "connections_refused",
            "Connections turned away because too many were open",
            connections_refused.clone(),
        );
        registry.register("websockets", "WebSockets open", sockets.clone());
        manager.metrics().register(manager.config().memory_bytes, &mut registry);
        Self {
            registry: Arc::new(registry),
            calls,
            seconds,
            in_flight,
            connections,
            connections_refused,
            sockets,
        }
    }

    /// All counts as OpenMetrics text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing into a String cannot fail.
        let _ = prometheus_client::encoding::text::encode(&mut text, &self.registry);
        text
    }
}

/// A number for a request that brings none.
pub(super) fn request_id() -> Arc<str> {
    use std::sync::LazyLock;
    use std::sync::atomic::{AtomicU64, Ordering};
    static START: LazyLock<u64> = LazyLock::new(|| getrandom::u64().unwrap_or_default());
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let number = START.wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    format!("{number:016x}").into()
}
