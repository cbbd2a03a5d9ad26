//! The caller of a request: read from a bearer token or a client's certificate, before anything else.
//!
//! Only this proof identifies a caller. No other header, path or message names a tenant.

mod authenticator;
mod jwt;
mod tokens;

pub use authenticator::AuthConfig;
pub(super) use authenticator::Authenticator;
pub(super) use jwt::JwtVerifier;
pub use jwt::{JwtConfig, KeySource};
pub use tokens::{LONGEST_TOKEN, TokenEntry, parse_expiry, token_digest};
pub(super) use tokens::{Principal, principal};
