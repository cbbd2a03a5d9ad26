//! Spans of calls and their pieces of work, sent by OTLP where an address is given.

use http::HeaderMap;
use opentelemetry::propagation::{Extractor, TextMapPropagator as _};
use opentelemetry::trace::TracerProvider as _;
use opentelemetry_otlp::WithExportConfig as _;
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::{SdkTracer, SdkTracerProvider};
use pliant_session::SPANS;
use std::time::Duration;
use tracing::Span;
use tracing::field::Empty;
use tracing_opentelemetry::OpenTelemetrySpanExt as _;

/// How long sending spans may take, and the last of them at the end.
const PATIENCE: Duration = Duration::from_secs(3);

/// The export of spans. They are sent in batches; those that find no room in the queue are dropped.
pub struct TraceExport(Option<SdkTracerProvider>);

impl TraceExport {
    /// Sends nothing.
    pub(super) fn none() -> Self {
        Self(None)
    }

    /// Prepares to send spans to the collector at `endpoint`; nothing is connected yet. Needs a running tokio.
    ///
    /// # Errors
    /// A text, when the address is none.
    pub(super) fn to_collector(endpoint: &str) -> Result<(Self, SdkTracer), String> {
        let exporter = opentelemetry_otlp::SpanExporter::builder()
            .with_tonic()
            .with_endpoint(endpoint)
            .with_timeout(PATIENCE)
            .build();
        let exporter = exporter.map_err(|e| e.to_string())?;
        let resource = Resource::builder().with_service_name("pliant").build();
        let provider = SdkTracerProvider::builder()
            .with_batch_exporter(exporter)
            .with_resource(resource)
            .build();
        let tracer = provider.tracer("pliant");
        Ok((Self(Some(provider)), tracer))
    }

    /// Sends what is left, for a few seconds at most.
    pub async fn finish(self) {
        let Some(provider) = self.0 else { return };
        // It waits for a thread of its own.
        let done = tokio::task::spawn_blocking(move || provider.shutdown_with_timeout(PATIENCE)).await;
        if let Ok(Err(error)) = done {
            tracing::warn!("the last spans were not sent: {error}");
        }
    }
}

/// The span of a call; part of the caller's trace where its headers name one (W3C trace context).
pub(super) fn call_span(transport: &'static str, route: &str, request_id: &str, headers: &HeaderMap) -> Span {
    let span = tracing::info_span!(
        target: SPANS,
        "call",
        otel.name = route,
        otel.kind = "server",
        otel.status_code = Empty,
        request.id = request_id,
        request.transport = transport,
        request.code = Empty,
    );
    if !span.is_disabled() && headers.contains_key("traceparent") {
        let caller = TraceContextPropagator::new().extract(&TraceHeaders(headers));
        // This fails only where no spans are collected.
        let _ = span.set_parent(caller);
    }
    span
}

/// Headers as the propagator reads them.
struct TraceHeaders<'a>(&'a HeaderMap);

impl Extractor for TraceHeaders<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key)?.to_str().ok()
    }

    fn keys(&self) -> Vec<&str> {
        self.0.keys().map(http::HeaderName::as_str).collect()
    }
}
