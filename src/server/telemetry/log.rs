//! Where log lines go and how they look.

use super::traces::TraceExport;
use crate::server::config::LogFormat;
use crate::session::SPANS;
use std::io::IsTerminal as _;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::format::FmtSpan;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _};

/// Starts writing log lines to stderr, and sending spans to the collector at `otlp_endpoint` if there is one. Called once, by
/// the program; a second call changes nothing.
///
/// # Errors
/// A text, when the address is none.
pub fn start(directives: &str, format: LogFormat, otlp_endpoint: Option<&str>) -> Result<TraceExport, String> {
    // Chatter of the protocol libraries helps nobody and slows streams; spans are lines only where they are asked for.
    let quiet =
        "h2=warn,hyper=warn,hyper_util=warn,tonic=warn,tower=warn,tungstenite=warn,sqlx=warn,opentelemetry=warn";
    let filter = EnvFilter::builder().parse_lossy(format!("{quiet},{SPANS}=off,{directives}"));
    let lines = tracing_subscriber::fmt::layer()
        .with_span_events(FmtSpan::CLOSE)
        // A line that cannot be written, on a full disk, is lost; telling that on the same disk would end the work that wrote it.
        .log_internal_errors(false)
        .with_writer(std::io::stderr);
    let lines = match format {
        LogFormat::Text => lines.with_ansi(std::io::stderr().is_terminal()).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).boxed(),
    };
    let (export, tracer) = match otlp_endpoint {
        None => (TraceExport::none(), None),
        Some(endpoint) => {
            let (export, tracer) = TraceExport::to_collector(endpoint)?;
            (export, Some(tracer))
        }
    };
    let spans = tracer.map(|tracer| {
        let only_spans = Targets::new().with_target(SPANS, LevelFilter::INFO);
        tracing_opentelemetry::layer()
            .with_tracer(tracer)
            .with_filter(only_spans)
    });
    let _ = tracing_subscriber::registry()
        .with(lines.with_filter(filter))
        .with(spans)
        .try_init();
    Ok(export)
}
