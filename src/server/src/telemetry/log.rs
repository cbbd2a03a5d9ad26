//! Where log lines go and how they look.

use super::traces::TraceExport;
use crate::config::LogFormat;
use pliant_session::SPANS;
use std::io::IsTerminal as _;
use std::sync::OnceLock;
use tracing::Level;
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
    // Log lines of the protocol libraries are of no use and slow streams; spans are lines only where they are asked for.
    let quiet =
        "h2=warn,hyper=warn,hyper_util=warn,tonic=warn,tower=warn,tungstenite=warn,sqlx=warn,opentelemetry=warn";
    let filter = EnvFilter::builder().parse_lossy(format!("{quiet},{SPANS}=off,{directives}"));
    let lines = tracing_subscriber::fmt::layer()
        .with_span_events(FmtSpan::CLOSE)
        // A line that cannot be written, on a full disk, is lost; a line about that on the same disk would end the work that wrote it.
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
    let started = tracing_subscriber::registry()
        .with(lines.with_filter(filter))
        .with(spans)
        .try_init();
    if started.is_ok() {
        let _ = FORMAT.set(format);
        log_panics();
    }
    Ok(export)
}

/// The form of log lines, once they are written.
static FORMAT: OnceLock<LogFormat> = OnceLock::new();

/// Whether the log is written as JSON, so that nothing else belongs on stderr.
pub fn is_json() -> bool {
    FORMAT.get() == Some(&LogFormat::Json)
}

/// Logs each panic as one line; where the log takes no errors, panics print as before.
fn log_panics() {
    let plainly = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !tracing::enabled!(Level::ERROR) {
            return plainly(panic);
        }
        let payload = panic.payload();
        let words = (payload.downcast_ref::<&str>().copied())
            .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
            .unwrap_or("no text");
        let place = panic.location().map(ToString::to_string).unwrap_or_default();
        let thread = std::thread::current();
        let thread = thread.name().unwrap_or("unnamed");
        tracing::error!(panic.place = %place, panic.thread = %thread, "a thread panicked: {words}");
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::sync::{Arc, Mutex, PoisonError};

    /// What was written, in memory.
    #[derive(Clone, Default)]
    struct Written(Arc<Mutex<Vec<u8>>>);

    impl Write for Written {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            all.extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_panic_is_one_line_of_the_log() {
        log_panics();
        let written = Written::default();
        let make = written.clone();
        let lines = tracing_subscriber::fmt::layer()
            .json()
            .flatten_event(true)
            .with_writer(move || make.clone());
        let subscriber = tracing_subscriber::registry().with(lines);
        tracing::subscriber::with_default(subscriber, || {
            assert!(std::panic::catch_unwind(|| panic!("two\nlines")).is_err());
        });
        let text = String::from_utf8(written.0.lock().unwrap().clone()).unwrap();
        assert_eq!(text.lines().count(), 1, "{text}");
        let line: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(
            (&line["level"], &line["message"]),
            (&"ERROR".into(), &"a thread panicked: two\nlines".into())
        );
        assert!(line["panic.place"].as_str().unwrap().contains("log.rs"), "{text}");
    }
}
