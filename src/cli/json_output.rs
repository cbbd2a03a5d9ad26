//! JSON documents on stdout.

use super::failure::CliFailure;
use crate::wire;
use serde_json::json;
use std::io::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether this process has printed its document, or a part of it.
static IS_PRINTED: AtomicBool = AtomicBool::new(false);

/// Prints one JSON document on stdout.
pub(super) fn print_json<M: prost::Message + prost::Name>(message: &M) -> Result<(), CliFailure> {
    print_value(&wire::json::to_json(message)?)
}

/// Prints one value on stdout.
pub(super) fn print_value(value: &serde_json::Value) -> Result<(), CliFailure> {
    print_text(&pretty_text(value)?)
}

/// A document as people read it, with the end of its last line.
pub(super) fn pretty_text(value: &serde_json::Value) -> Result<String, CliFailure> {
    let text = serde_json::to_string_pretty(value).map_err(|e| CliFailure::Internal(e.to_string()))?;
    Ok(text + "\n")
}

/// Prints the text of one document on stdout.
pub(super) fn print_text(text: &str) -> Result<(), CliFailure> {
    IS_PRINTED.store(true, Ordering::Relaxed);
    let mut stdout = std::io::stdout();
    let written = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
    written.map_err(|e| CliFailure::Internal(format!("cannot write to stdout: {e}")))
}

/// Prints a command's failure as its JSON document, with `--json` and where none was printed; a failed check has
/// printed one.
pub(super) fn print_failure(failure: &CliFailure) {
    let is_asked = std::env::args_os().skip(1).any(|argument| argument == "--json");
    if !is_asked || IS_PRINTED.load(Ordering::Relaxed) {
        return;
    }
    let error = json!({"kind": failure.kind(), "exitCode": failure.exit_code(), "message": failure.message()});
    // The last line of stderr says it too, and the exit code.
    let _ = print_value(&json!({ "error": error }));
}
