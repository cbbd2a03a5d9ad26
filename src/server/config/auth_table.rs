//! The table `auth` of the configuration's file, as it stands there.

use serde::Deserialize;

/// The table `auth` says who may call. It stands in the file alone: neither flags nor the environment are a place for it.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuthTable {
    /// Tokens that are known.
    #[serde(default)]
    pub(super) tokens: Vec<TokenTable>,
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
