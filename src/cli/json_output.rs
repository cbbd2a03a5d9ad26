//! JSON documents on stdout.

use super::failure::CliFailure;
use crate::wire::json;

/// Prints one JSON document on stdout. A reader that went away is no failure of ours to report twice.
pub(super) fn print_json<M: prost::Message + prost::Name>(message: &M) -> Result<(), CliFailure> {
    print_value(&json::to_json(message)?)
}

/// Prints one value on stdout.
pub(super) fn print_value(value: &serde_json::Value) -> Result<(), CliFailure> {
    use std::io::Write as _;
    let text = serde_json::to_string_pretty(value).map_err(|e| CliFailure::Internal(e.to_string()))?;
    writeln!(std::io::stdout(), "{text}").map_err(|e| CliFailure::Internal(format!("cannot write to stdout: {e}")))
}
