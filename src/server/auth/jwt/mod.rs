//! Tokens that somebody else signs: JSON Web Tokens (RFC 7519) of one issuer, checked with the keys that it publishes (RFC 7517).

mod jwt_config;
mod jwt_verifier;
mod key_set;
mod key_source;
mod ring_verifier;

pub use jwt_config::{JwtConfig, KeySource};
pub(in crate::server) use jwt_verifier::JwtVerifier;
