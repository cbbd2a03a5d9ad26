//! Whose tokens are believed.

use jsonwebtoken::Algorithm;
use std::path::PathBuf;
use std::time::Duration;

/// This says whose tokens are believed, and which of their claims names the tenant.
#[derive(Debug, Clone, PartialEq)]
pub struct JwtConfig {
    /// Where the issuer's keys are.
    pub keys: KeySource,
    /// The claim `iss` that a token must have.
    pub issuer: String,
    /// The claim `aud` must name one of these.
    pub audiences: Vec<String>,
    /// Algorithms that are believed. All have a public key and a private one: a published key must not be one to sign with.
    pub algorithms: Vec<Algorithm>,
    /// The claim that is the tenant.
    pub tenant_claim: String,
    /// By how much clocks may differ when `exp` and `nbf` are looked at.
    pub leeway: Duration,
    /// How often keys are fetched that have an address.
    pub refresh: Duration,
    /// How long it takes, at least, from one fetch for a key that is not known to the next.
    pub unknown_key_pause: Duration,
}

/// Where keys are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KeySource {
    /// A file, which is followed.
    File(PathBuf),
    /// An address, and the PEM file of the authorities that may sign its certificate where those of the machine are not meant.
    Url(String, Option<PathBuf>),
}

impl JwtConfig {
    /// Algorithms that can be believed. RSA keys have at least 2048 bits.
    pub const ALGORITHMS: [(&'static str, Algorithm); 9] = [
        ("RS256", Algorithm::RS256),
        ("RS384", Algorithm::RS384),
        ("RS512", Algorithm::RS512),
        ("PS256", Algorithm::PS256),
        ("PS384", Algorithm::PS384),
        ("PS512", Algorithm::PS512),
        ("ES256", Algorithm::ES256),
        ("ES384", Algorithm::ES384),
        ("EdDSA", Algorithm::EdDSA),
    ];
}
