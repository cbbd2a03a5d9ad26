//! What `pliant serve` prints at its start: its address, in the one line of stdout, and what to try with the sample.
//!
//! With `log_format = "json"` both are JSON lines like the log's, for log collectors.

use crate::server::config::LogFormat;
use std::io::{IsTerminal as _, Write as _};
use std::time::SystemTime;

/// Writes to stdout where the server listens; a parent process may wait for this line. A write error does not stop the
/// server.
pub(super) fn tell_listening(url: &str, format: LogFormat) {
    let words = format!("listening on {url}");
    let line = match format {
        LogFormat::Text => words,
        LogFormat::Json => serde_json::json!({
            "timestamp": humantime::format_rfc3339_micros(SystemTime::now()).to_string(),
            "level": "INFO",
            "message": words,
            "target": module_path!(),
        })
        .to_string(),
    };
    let mut out = std::io::stdout();
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

/// Prints what to try with the sample session: a text to copy on a terminal, else lines of the log.
pub(super) fn tell_sample(base: &str, id: &str, format: LogFormat) {
    let session = format!("{base}/v1/sessions/{id}");
    let body = r#"{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, -0.8, 0.4]}}]}}"#;
    let tries = [
        format!("curl -s {session}"),
        format!(
            "curl -s {session}/solve -H 'content-type: application/json' -H 'accept: model/gltf-binary' -o turned.glb -d '{body}'"
        ),
        format!("curl -s -X POST {session}/undo"),
        format!("curl -s '{session}/model?format=obj' -o creature.obj"),
    ];
    let mut err = std::io::stderr();
    if format == LogFormat::Json || !err.is_terminal() {
        for line in &tries {
            tracing::info!("to try: {line}");
        }
        return;
    }
    let listed: String = tries.iter().map(|line| format!("  {line}\n")).collect();
    let text = format!(
        "\nA sample session is open: a creature with fixed feet and a movable head. Open {base}/ to see it, or try:\n\n{listed}\n"
    );
    let _ = err.write_all(text.as_bytes());
}
