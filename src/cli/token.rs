//! `pliant token`: a new token, and the lines by which a server knows its bearer.

use super::terminal::{CliFailure, print_text};
use crate::server::auth::{parse_expiry, token_digest};
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use clap::Args;
use std::time::SystemTime;

/// Makes a token: its text in the first line of stdout, and after an empty one what to add to the server's configuration.
///
/// The server keeps only what the token hashes to. The text is shown once and stored nowhere; give it to its bearer.
#[derive(Debug, Args)]
pub struct TokenArgs {
    /// Tenant: the token gives access to its sessions
    #[arg(value_parser = parse_name)]
    tenant: String,
    /// Name of the caller in logs [default: the tenant]
    #[arg(long, value_name = "NAME", value_parser = parse_name)]
    name: Option<String>,
    /// Time at which the token expires, such as 2027-01-31
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    expires: Option<String>,
    /// Allow reading /metrics too, which counts for all tenants
    #[arg(long)]
    metrics: bool,
}

fn parse_name(text: &str) -> Result<String, String> {
    if text.is_empty() || text.len() > 256 || text.chars().any(char::is_control) {
        return Err("1 to 256 bytes without control characters are allowed".into());
    }
    Ok(text.to_owned())
}

fn parse_time(text: &str) -> Result<String, String> {
    let expiry = parse_expiry(text)?;
    if expiry <= SystemTime::now() {
        return Err("that time has passed, so the server would reject the token; give a later one".into());
    }
    Ok(humantime::format_rfc3339_seconds(expiry).to_string())
}

pub(super) fn run_token(args: &TokenArgs) -> Result<(), CliFailure> {
    let mut secret = [0u8; 32];
    getrandom::fill(&mut secret).map_err(|e| CliFailure::Internal(format!("cannot get random bytes: {e}")))?;
    let token = format!("pliant_{}", URL_SAFE_NO_PAD.encode(secret));
    let sha256: String = token_digest(&token).iter().map(|b| format!("{b:02x}")).collect();
    // TOML's basic strings are JSON's, as far as names go that hold no control characters.
    let quoted = |text: &str| serde_json::Value::from(text).to_string();
    let mut text = format!("{token}\n\n[[auth.tokens]]\ntenant = {}\n", quoted(&args.tenant));
    if let Some(name) = &args.name {
        text += &format!("name = {}\n", quoted(name));
    }
    text += &format!("sha256 = \"{sha256}\"\n");
    if let Some(expires) = &args.expires {
        text += &format!("expires = \"{expires}\"\n");
    }
    if args.metrics {
        text += "metrics = true\n";
    }
    print_text(&text)
}
