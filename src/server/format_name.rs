//! Names of the formats of results, as callers write them.

use crate::asset::Format;
use crate::session::Error;

/// Reads the name of a format that results can be had in.
///
/// # Errors
/// `INVALID_ARGUMENT` on `field`, with the names that are allowed.
pub(super) fn parse_format_name(field: &str, name: &str) -> Result<Format, Error> {
    let format = Format::from_name(name).ok_or_else(|| {
        let names = Format::ALL.map(Format::name).join(", ");
        let shown: String = name.chars().take(64).collect();
        Error::invalid(field, format!("\"{shown}\" is not a format; allowed are {names}"))
    })?;
    match format.refusal_to_write() {
        Some(problem) => Err(Error::invalid(field, problem)),
        None => Ok(format),
    }
}
