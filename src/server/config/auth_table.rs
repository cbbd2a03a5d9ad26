//! The table `auth` of the configuration's file, as it stands there.

use super::units::{TimeSpan, WordList};
use serde::Deserialize;

/// The table `auth` says who may call. It stands in the file alone: neither flags nor the environment are a place for it.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuthTable {
    /// Tokens that are known.
    #[serde(default)]
    pub(super) tokens: Vec<TokenTable>,
    /// Tokens of an issuer that are believed.
    pub(super) jwt: Option<JwtTable>,
}

/// One token, as it stands in the file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenTable {
    pub(super) tenant: String,
    pub(super) sha256: String,
    pub(super) name: Option<String>,
    pub(super) expires: Option<String>,
    #[serde(default)]
    pub(super) metrics: bool,
}

/// Whose tokens are believed, as it stands in the file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JwtTable {
    pub(super) jwks: String,
    pub(super) ca: Option<String>,
    pub(super) issuer: String,
    pub(super) audience: WordList,
    pub(super) algorithms: Option<WordList>,
    pub(super) tenant_claim: Option<String>,
    pub(super) leeway: Option<TimeSpan>,
    pub(super) refresh: Option<TimeSpan>,
}
