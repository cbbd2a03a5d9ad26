//! Measures a call to the end of its answer, whichever way it ends.

use super::traces::call_span;
use super::{Call, RouteLabels, Telemetry};
use crate::server::auth::Principal;
use axum::body::Body;
use bytes::Bytes;
use http::{HeaderMap, Method, Request};
use http_body::{Body as HttpBody, Frame, SizeHint};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};
use tracing::Span;

/// Where lines of the access log go: one for each call, without its query and its headers, which may hold secrets.
const ACCESS: &str = "pliant::access";

/// Longest path that is logged, in characters.
const LONGEST_PATH: usize = 256;

/// A request's facts in a line of the access log.
struct AccessFacts {
    caller: Option<Principal>,
    method: Method,
    path: String,
    /// Asked every second by those who watch; logged at debug.
    is_probe: bool,
}

impl AccessFacts {
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
pub(in crate::server) struct Recorder {
    telemetry: Telemetry,
    transport: &'static str,
    route: Arc<str>,
    request_id: Arc<str>,
    access: AccessFacts,
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
        (transport, route): (&'static str, impl Into<Arc<str>>),
        request_id: Arc<str>,
        request: &Request<B>,
    ) -> Self {
        telemetry.in_flight.inc();
        let route: Arc<str> = route.into();
        Self {
            telemetry: telemetry.clone(),
            transport,
            span: call_span(transport, &route, &request_id, request.headers()),
            route,
            request_id,
            access: AccessFacts::of(request),
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
        let AccessFacts {
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
        let call = Call {
            transport: self.transport,
            route: Arc::clone(&self.route),
            code,
        };
        self.telemetry.calls.get_or_create(&call).inc();
    }
}

/// A response body that carries its [`Recorder`].
struct Observed {
    inner: Body,
    recorder: Recorder,
}

impl HttpBody for Observed {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let frame = ready!(Pin::new(&mut self.inner).poll_frame(cx));
        if let Some(Ok(frame)) = &frame
            && let Some(data) = frame.data_ref()
        {
            self.recorder.sent += data.len() as u64;
        }
        if let Some(Ok(frame)) = &frame
            && let Some(code) = frame.trailers_ref().and_then(grpc_code)
        {
            self.recorder.set_code(code);
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
pub(in crate::server) fn grpc_code(headers: &HeaderMap) -> Option<Arc<str>> {
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
