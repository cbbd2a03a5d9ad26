//! Where log lines go and how they look.

use crate::server::config::LogFormat;
use std::io::IsTerminal as _;
use tracing_subscriber::EnvFilter;

/// Starts writing log lines to stderr. Called once, by the program; a second call changes nothing.
pub fn start(directives: &str, format: LogFormat) {
    // Chatter of the protocol libraries helps nobody and slows streams.
    let quiet = "h2=warn,hyper=warn,hyper_util=warn,tonic=warn,tower=warn,tungstenite=warn,sqlx=warn";
    let filter = EnvFilter::builder().parse_lossy(format!("{quiet},{directives}"));
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        // A line that cannot be written, on a full disk, is lost; telling that on the same disk would end the work that wrote it.
        .log_internal_errors(false)
        .with_writer(std::io::stderr);
    let _ = match format {
        LogFormat::Text => lines.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
}
