//! Who may call, as the table `auth` says.

use super::Error;
use super::keys::ConfigKeys;
use super::keys::TimeSpan;
use super::keys::{JwtTable, TokenTable};
use super::sources::MergedKeys;
use crate::auth::{AuthConfig, JwtConfig, KeySource, TokenEntry, parse_expiry};
use crate::request_filter::is_this_machine;
use http::Uri;
use pliant_session::Tenant;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Most tokens of one file: each call compares with all of them.
pub const MOST_TOKENS: usize = 10_000;

/// Longest name of a tenant or a token, bytes.
const LONGEST_NAME: usize = 256;

/// Reads how callers prove who they are.
pub(super) fn auth_from_keys(merged: &MergedKeys, file: Option<&Path>) -> Result<AuthConfig, Error> {
    let table = merged.keys.auth.clone().unwrap_or_default();
    if table.tokens.len() > MOST_TOKENS {
        let seen = table.tokens.len();
        return Err(merged.refuse(
            "auth.tokens",
            format!("there are {seen}, at most {MOST_TOKENS} are allowed"),
        ));
    }
    let mut tokens: Vec<TokenEntry> = Vec::with_capacity(table.tokens.len());
    for (k, token) in table.tokens.into_iter().enumerate() {
        let refuse = |field: &str, problem: String| merged.refuse(&format!("auth.tokens[{k}].{field}"), problem);
        let entry = read_token(token, &refuse)?;
        if let Some(other) = tokens.iter().position(|t| t.sha256 == entry.sha256) {
            return Err(refuse(
                "sha256",
                format!("is also that of auth.tokens[{other}]; a token belongs to one caller"),
            ));
        }
        tokens.push(entry);
    }
    let refuse_jwt = |field: &str, problem: String| merged.refuse(&format!("auth.jwt.{field}"), problem);
    let jwt = table.jwt.map(|jwt| read_jwt(jwt, &refuse_jwt)).transpose()?;
    Ok(AuthConfig {
        tokens,
        jwt,
        file: file.map(Path::to_owned),
    })
}

/// Rereads the tokens of a file.
///
/// # Errors
/// What is wrong with the file; its other keys are checked as well.
pub(crate) fn tokens_of_file(file: &Path) -> Result<Vec<TokenEntry>, Error> {
    let merged = MergedKeys::collect(Some(file), &ConfigKeys::default())?;
    Ok(auth_from_keys(&merged, Some(file))?.tokens)
}

fn read_token(table: TokenTable, refuse: &dyn Fn(&str, String) -> Error) -> Result<TokenEntry, Error> {
    let name = table.name.unwrap_or_else(|| table.tenant.clone());
    for (field, text) in [("tenant", &table.tenant), ("name", &name)] {
        if text.is_empty() || text.len() > LONGEST_NAME || text.chars().any(char::is_control) {
            let allowed = format!("1 to {LONGEST_NAME} bytes without control characters are allowed");
            return Err(refuse(field, format!("{text:?} is not a name; {allowed}")));
        }
    }
    // What stands there may be the token itself, by mistake: it is not repeated.
    let sha256 = from_hex(&table.sha256).ok_or_else(|| {
        let allowed = "64 hexadecimal digits are allowed, as `pliant token` prints them";
        refuse("sha256", format!("is not a SHA-256; {allowed}"))
    })?;
    let expires = table
        .expires
        .map(|text| parse_expiry(&text).map_err(|problem| refuse("expires", problem)));
    Ok(TokenEntry {
        tenant: Tenant(table.tenant.into()),
        sha256,
        name,
        expires: expires.transpose()?,
        metrics: table.metrics,
    })
}

fn read_jwt(table: JwtTable, refuse: &dyn Fn(&str, String) -> Error) -> Result<JwtConfig, Error> {
    let audiences: Vec<String> = table.audience.0.into_iter().filter(|name| !name.is_empty()).collect();
    let tenant_claim = table.tenant_claim.unwrap_or_else(|| "tenant".into());
    for (field, is_empty) in [
        ("issuer", table.issuer.is_empty()),
        ("audience", audiences.is_empty()),
        ("tenant_claim", tenant_claim.is_empty()),
        ("jwks", table.jwks.is_empty()),
    ] {
        if is_empty {
            return Err(refuse(field, "is empty".into()));
        }
    }
    let listed = table
        .algorithms
        .map_or_else(|| ["RS256", "ES256", "EdDSA"].map(String::from).to_vec(), |list| list.0);
    let mut algorithms = Vec::new();
    for name in &listed {
        match JwtConfig::ALGORITHMS.iter().find(|(known, _)| known == name) {
            Some((_, algorithm)) => algorithms.push(*algorithm),
            None => {
                let known: Vec<&str> = JwtConfig::ALGORITHMS.iter().map(|(name, _)| *name).collect();
                let problem = format!("\"{name}\" is not accepted here; allowed are {}", known.join(", "));
                return Err(refuse("algorithms", problem));
            }
        }
    }
    if algorithms.is_empty() {
        return Err(refuse(
            "algorithms",
            "is empty, so the server would accept no token".into(),
        ));
    }
    let span = |field: &str, value: Option<TimeSpan>, default: u64, from: u64, to: u64| {
        let seconds = value.map_or(Duration::from_secs(default), |span| span.0);
        if seconds < Duration::from_secs(from) || seconds > Duration::from_secs(to) {
            return Err(refuse(field, format!("is out of range; allowed are {from}s to {to}s")));
        }
        Ok(seconds)
    };
    Ok(JwtConfig {
        keys: key_source(&table.jwks, table.ca, refuse)?,
        issuer: table.issuer,
        audiences,
        algorithms,
        tenant_claim,
        leeway: span("leeway", table.leeway, 60, 0, 300)?,
        refresh: span("refresh", table.refresh, 600, 10, 86_400)?,
        unknown_key_pause: Duration::from_secs(30),
    })
}

/// An address begins with a scheme. Its answer decides who may call, so it must be encrypted, except on this machine.
fn key_source(jwks: &str, ca: Option<String>, refuse: &dyn Fn(&str, String) -> Error) -> Result<KeySource, Error> {
    if !jwks.contains("://") {
        return Ok(KeySource::File(jwks.into()));
    }
    let uri = jwks.parse::<Uri>().ok();
    let guarded = uri.is_some_and(|uri| match (uri.scheme_str(), uri.host()) {
        (Some("https"), Some(_)) => true,
        (Some("http"), Some(host)) => is_this_machine(host.trim_matches(['[', ']'])),
        _ => false,
    });
    if !guarded {
        let allowed = "allowed are a file, https://…, and http://… of this machine";
        return Err(refuse("jwks", format!("\"{jwks}\" is not accepted; {allowed}")));
    }
    Ok(KeySource::Url(jwks.to_owned(), ca.map(PathBuf::from)))
}

fn from_hex(text: &str) -> Option<[u8; 32]> {
    let digits: Vec<u8> = text
        .chars()
        .map(|c| c.to_digit(16).and_then(|d| u8::try_from(d).ok()))
        .collect::<Option<_>>()?;
    let bytes: Vec<u8> = digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect();
    (digits.len() == 64).then(|| bytes.try_into().ok()).flatten()
}
