//! Log lines, counts and traces for operators. Nothing here decides anything.
//!
//! Log lines read as sentences and have dotted fields (`session.id`, `duration_ms`). Each call has one line at info (target
//! `pliant::access`), failures of the server are errors, and nothing is logged per frame.

mod log;
mod traces;

pub use log::is_json as logs_json;
pub use log::start as start_log;
pub use traces::TraceExport;

use crate::auth::Principal;
use axum::body::Body;
use bytes::Bytes;
use http::{HeaderMap, Method, Request};
use http_body::{Body as HttpBody, Frame, SizeHint};
use pliant_session::Metrics;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::{encode, encode_registry};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};
use traces::call_span;
use tracing::Span;

/// The labels of a finished call. Routes and methods come from fixed lists, so their number is bounded.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub(super) struct CallLabels {
    transport: &'static str,
    route: Arc<str>,
    code: Arc<str>,
}

/// The labels of durations.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub(super) struct RouteLabels {
    transport: &'static str,
    route: Arc<str>,
}

/// Counts of the server. Cloning shares them.
#[derive(Clone)]
pub(super) struct Telemetry {
    registry: Arc<Registry>,
    calls: Family<CallLabels, Counter>,
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
    /// Counts that are all 0.
    pub fn new() -> Self {
        let mut registry = Registry::with_prefix("pliant");
        let calls = Family::<CallLabels, Counter>::default();
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

    /// All counts as OpenMetrics text, those of `sessions` after the server's own.
    pub fn text(&self, sessions: &Metrics) -> String {
        let mut text = String::new();
        // Writing into a String cannot fail.
        let _ = encode_registry(&mut text, &self.registry).and_then(|()| encode(&mut text, sessions.registry()));
        text
    }
}

/// An id for a request that has none.
pub(super) fn request_id() -> Arc<str> {
    use std::sync::LazyLock;
    use std::sync::atomic::{AtomicU64, Ordering};
    static START: LazyLock<u64> = LazyLock::new(|| getrandom::u64().unwrap_or_default());
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let number = START.wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    format!("{number:016x}").into()
}

/// Where lines of the access log go: one for each call, without its query and its headers, which may hold secrets.
const ACCESS: &str = "pliant::access";

/// Longest path that is logged, in characters.
const LONGEST_PATH: usize = 256;

/// The request in a line of the access log.
struct AccessEntry {
    caller: Option<Principal>,
    method: Method,
    path: String,
    /// A monitor sends it every second; it is logged at debug.
    is_probe: bool,
}

impl AccessEntry {
    fn of<B>(request: &Request<B>) -> Self {
        let path = request.uri().path();
        Self {
            caller: request.extensions().get::<Principal>().cloned(),
            method: request.method().clone(),
            path: path.chars().take(LONGEST_PATH).collect(),
            is_probe: ["/healthz", "/readyz", "/metrics"].contains(&path)
                || path.starts_with("/grpc.health.v1.Health/"),
        }
    }
}

/// A call under way. Counts it when finished or dropped, once.
pub(super) struct Recorder {
    telemetry: Telemetry,
    transport: &'static str,
    route: Arc<str>,
    request_id: Arc<str>,
    access: AccessEntry,
    started: Instant,
    code: Option<Arc<str>>,
    /// Bytes of the answer's body that were sent.
    sent: u64,
    span: Span,
}

impl Recorder {
    /// Starts to measure a call.
    pub fn start<B>(
        telemetry: &Telemetry,
        transport: &'static str,
        route: impl Into<Arc<str>>,
        request_id: Arc<str>,
        request: &Request<B>,
    ) -> Self {
        telemetry.in_flight.inc();
        let route = route.into();
        Self {
            telemetry: telemetry.clone(),
            transport,
            span: call_span(transport, &route, &request_id, request.headers()),
            route,
            request_id,
            access: AccessEntry::of(request),
            started: Instant::now(),
            code: None,
            sent: 0,
        }
    }

    /// The span of the call.
    pub fn span(&self) -> Span {
        self.span.clone()
    }

    /// The status with which the call will count.
    pub fn set_code(&mut self, code: impl Into<Arc<str>>) {
        self.code = Some(code.into());
    }

    /// Writes the call's line of the access log.
    fn log(&self, code: &str, elapsed: Duration) {
        let AccessEntry {
            caller,
            method,
            path,
            is_probe,
        } = &self.access;
        macro_rules! line {
            ($level:ident) => {
                tracing::$level!(
                    target: ACCESS,
                    tenant = caller.as_ref().map(|c| &*c.tenant.0),
                    caller = caller.as_ref().map(|c| &*c.name),
                    request.id = %self.request_id,
                    request.transport = self.transport,
                    status = %code,
                    duration_ms = (elapsed.as_secs_f64() * 1e6).round() / 1e3,
                    size_bytes = self.sent,
                    "{method} {path}"
                )
            };
        }
        if *is_probe { line!(debug) } else { line!(info) }
    }

    /// Keeps measuring until `body` has been sent. A gRPC status in its trailers is the call's code.
    pub fn observe(self, body: Body) -> Body {
        Body::new(Observed {
            inner: body,
            recorder: self,
        })
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let code: Arc<str> = self.code.take().unwrap_or_else(|| "CANCELLED".into());
        let elapsed = self.started.elapsed();
        self.telemetry.in_flight.dec();
        self.log(&code, elapsed);
        self.span.record("request.code", &*code);
        if ["500", "INTERNAL", "DATA_LOSS", "UNKNOWN"].contains(&&*code) {
            self.span.record("otel.status_code", "ERROR");
        }
        let route = RouteLabels {
            transport: self.transport,
            route: Arc::clone(&self.route),
        };
        self.telemetry
            .seconds
            .get_or_create(&route)
            .observe(elapsed.as_secs_f64());
        let call = CallLabels {
            transport: self.transport,
            route: Arc::clone(&self.route),
            code,
        };
        self.telemetry.calls.get_or_create(&call).inc();
    }
}

/// A response body with its [`Recorder`]. By hand, because `map_frame` of http-body-util forgets the size of a body.
struct Observed {
    inner: Body,
    recorder: Recorder,
}

impl HttpBody for Observed {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let frame = ready!(Pin::new(&mut self.inner).poll_frame(cx));
        if let Some(Ok(frame)) = &frame {
            self.recorder.sent += frame.data_ref().map_or(0, |data| data.len() as u64);
            if let Some(code) = frame.trailers_ref().and_then(grpc_code) {
                self.recorder.set_code(code);
            }
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

/// The name of the gRPC status in headers or trailers.
pub(super) fn grpc_code(headers: &HeaderMap) -> Option<Arc<str>> {
    let number: i32 = headers.get("grpc-status")?.to_str().ok()?.parse().ok()?;
    // Spelled as the documentation of gRPC spells them.
    const NAMES: [&str; 17] = [
        "OK",
        "CANCELLED",
        "UNKNOWN",
        "INVALID_ARGUMENT",
        "DEADLINE_EXCEEDED",
        "NOT_FOUND",
        "ALREADY_EXISTS",
        "PERMISSION_DENIED",
        "RESOURCE_EXHAUSTED",
        "FAILED_PRECONDITION",
        "ABORTED",
        "OUT_OF_RANGE",
        "UNIMPLEMENTED",
        "INTERNAL",
        "UNAVAILABLE",
        "DATA_LOSS",
        "UNAUTHENTICATED",
    ];
    usize::try_from(number)
        .ok()
        .and_then(|n| NAMES.get(n))
        .map(|name| Arc::from(*name))
}
