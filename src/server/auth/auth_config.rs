//! How callers prove who they are.

use super::jwt::JwtConfig;
use crate::session::Tenant;
use std::fmt;
use std::path::PathBuf;
use std::time::SystemTime;

/// This says how callers prove who they are. Where it names no way, and certificates of clients are none either, everybody is the
/// tenant "default".
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AuthConfig {
    /// The tokens that are known.
    pub tokens: Vec<TokenEntry>,
    /// The file that they were read from; tokens follow it when it changes.
    pub file: Option<PathBuf>,
    /// The tokens of an issuer that are believed.
    pub jwt: Option<JwtConfig>,
}

/// Reads a point in time, such as `2027-01-31T12:00:00Z`, or a day, which stands for its beginning in UTC.
pub fn parse_expiry(text: &str) -> Result<SystemTime, String> {
    let day = format!("{text}T00:00:00Z");
    let whole = if text.len() == 10 { &day } else { text };
    humantime::parse_rfc3339_weak(whole)
        .map_err(|_| format!("\"{text}\" is not a time; allowed are 2027-01-31, 2027-01-31T12:00:00Z and the like"))
}

impl AuthConfig {
    /// Whether a token can be known.
    pub fn knows_tokens(&self) -> bool {
        !self.tokens.is_empty() || self.jwt.is_some()
    }
}

/// A token that is known. It holds what the token hashes to, which is of no use to who reads it.
#[derive(Clone, PartialEq, Eq)]
pub struct TokenEntry {
    /// Whose sessions its bearer sees.
    pub tenant: Tenant,
    /// SHA-256 of the token's text.
    pub sha256: [u8; 32],
    /// What its bearer is called in logs.
    pub name: String,
    /// From when on it is refused.
    pub expires: Option<SystemTime>,
    /// Whether its bearer may read `/metrics`, which counts for all tenants.
    pub metrics: bool,
}

impl fmt::Debug for TokenEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TokenEntry")
            .field("tenant", &self.tenant.0)
            .field("name", &self.name)
            .field("expires", &self.expires)
            .finish_non_exhaustive()
    }
}
