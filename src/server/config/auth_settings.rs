//! Who may call, as the table `auth` says.

use super::Error;
use super::auth_table::TokenTable;
use super::keys::ConfigKeys;
use super::sources::MergedKeys;
use crate::server::auth::{AuthConfig, TokenEntry, parse_expiry};
use crate::session::Tenant;
use std::path::Path;

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
    for (k, told) in table.tokens.into_iter().enumerate() {
        let refuse = |field: &str, problem: String| merged.refuse(&format!("auth.tokens[{k}].{field}"), problem);
        let entry = read_token(told, &refuse)?;
        if let Some(other) = tokens.iter().position(|t| t.sha256 == entry.sha256) {
            return Err(refuse(
                "sha256",
                format!("is that of auth.tokens[{other}], too; a token has one bearer"),
            ));
        }
        tokens.push(entry);
    }
    Ok(AuthConfig {
        tokens,
        file: file.map(Path::to_owned),
    })
}

/// Reads the tokens of a file anew.
///
/// # Errors
/// What is wrong with the file; its other keys are checked as well.
pub(in crate::server) fn tokens_of_file(file: &Path) -> Result<Vec<TokenEntry>, Error> {
    let merged = MergedKeys::collect(Some(file), &ConfigKeys::default())?;
    Ok(auth_from_keys(&merged, Some(file))?.tokens)
}

fn read_token(told: TokenTable, refuse: &dyn Fn(&str, String) -> Error) -> Result<TokenEntry, Error> {
    let name = told.name.unwrap_or_else(|| told.tenant.clone());
    for (field, text) in [("tenant", &told.tenant), ("name", &name)] {
        if text.is_empty() || text.len() > LONGEST_NAME || text.chars().any(char::is_control) {
            let allowed = format!("1 to {LONGEST_NAME} bytes without control characters are allowed");
            return Err(refuse(field, format!("{text:?} is no name; {allowed}")));
        }
    }
    // What stands there may be the token itself, by mistake: it is not repeated.
    let sha256 = from_hex(&told.sha256).ok_or_else(|| {
        let allowed = "64 hexadecimal digits are allowed, as `pliant token` prints them";
        refuse("sha256", format!("is no SHA-256; {allowed}"))
    })?;
    let expires = told
        .expires
        .map(|text| parse_expiry(&text).map_err(|problem| refuse("expires", problem)));
    Ok(TokenEntry {
        tenant: Tenant(told.tenant.into()),
        sha256,
        name,
        expires: expires.transpose()?,
        metrics: told.metrics,
    })
}

fn from_hex(text: &str) -> Option<[u8; 32]> {
    let digits: Vec<u8> = text
        .chars()
        .map(|c| c.to_digit(16).and_then(|d| u8::try_from(d).ok()))
        .collect::<Option<_>>()?;
    let bytes: Vec<u8> = digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect();
    (digits.len() == 64).then(|| bytes.try_into().ok()).flatten()
}
