//! The caller of a request: read from a bearer token or a client's certificate, before anything else.
//!
//! Only this proof identifies a caller. No other header, path or message names a tenant.

mod auth_config;
mod gatekeeper;
mod jwt;
mod presented_token;
mod principal;
mod token_list;

pub use auth_config::{AuthConfig, TokenEntry, parse_expiry};
pub(super) use gatekeeper::Gatekeeper;
pub(super) use jwt::JwtVerifier;
pub use jwt::{JwtConfig, KeySource};
pub use presented_token::LONGEST_TOKEN;
pub(super) use principal::{Principal, principal};
pub use token_list::token_digest;
