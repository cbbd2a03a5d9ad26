//! The one place where requests are let in.

use super::auth_config::{AuthConfig, TokenEntry};
use super::jwt::JwtVerifier;
use super::presented_token::presented_token;
use super::principal::{Principal, unknown_caller};
use super::token_list::token_bearer;
use crate::session::Error;
use arc_swap::ArcSwap;
use http::Request;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

/// Lets requests in. Cloning shares what it knows.
#[derive(Clone)]
pub(in crate::server) struct Gatekeeper(Arc<Known>);

struct Known {
    tokens: ArcSwap<Vec<TokenEntry>>,
    jwt: Option<JwtVerifier>,
    /// Whether callers must say who they are. Once they must, they must until the server ends: a list of tokens that was emptied
    /// by mistake opens nothing.
    asks: AtomicBool,
}

impl Gatekeeper {
    /// Knows what `config` says; `certificates` is whether clients may show certificates instead.
    ///
    /// # Errors
    /// The file of keys that cannot be used, and why.
    pub fn new(config: &AuthConfig, certificates: bool) -> Result<Self, String> {
        Ok(Self(Arc::new(Known {
            asks: AtomicBool::new(certificates || config.knows_tokens()),
            tokens: ArcSwap::from_pointee(config.tokens.clone()),
            jwt: config.jwt.as_ref().map(JwtVerifier::new).transpose()?,
        })))
    }

    /// Looks whether the keys that tokens are checked with have changed.
    pub async fn follow_keys(&self) {
        if let Some(jwt) = &self.0.jwt {
            jwt.follow().await;
        }
    }

    /// Replaces the tokens; requests from now on are compared with these.
    pub fn replace_tokens(&self, tokens: Vec<TokenEntry>) {
        if !tokens.is_empty() {
            self.0.asks.store(true, Ordering::Relaxed);
        }
        self.0.tokens.store(Arc::new(tokens));
    }

    /// Records the caller in a request. `shown` comes from the connection's certificate; a token takes precedence.
    ///
    /// # Errors
    /// `UNAUTHENTICATED` without credentials or with invalid ones, except for public pages. `UNAVAILABLE` where they
    /// cannot be checked now.
    pub async fn admit<B>(&self, request: &mut Request<B>, shown: Option<&Principal>) -> Result<(), Error> {
        if !self.0.asks.load(Ordering::Relaxed) {
            request.extensions_mut().insert(Principal::anyone());
            return Ok(());
        }
        if is_open(request.uri().path()) {
            return Ok(());
        }
        let token = presented_token(request)?.map(str::to_owned);
        let principal = match (token, &self.0.jwt, shown) {
            (Some(token), Some(jwt), _) if JwtVerifier::looks_like_one(&token) => jwt.bearer(&token).await?,
            (Some(token), _, _) => token_bearer(&self.0.tokens.load(), &token, SystemTime::now())?,
            (None, _, Some(shown)) => shown.clone(),
            (None, _, None) => return Err(unknown_caller()),
        };
        request.extensions_mut().insert(principal);
        Ok(())
    }
}

/// Whether a path is public: health, the pages for people with their files, and the description of the API. The page at
/// `/` asks for a token itself. All other paths are closed, also those that do not exist.
fn is_open(path: &str) -> bool {
    const PAGES: [&str; 7] = [
        "/healthz",
        "/readyz",
        "/",
        "/icon.svg",
        "/docs",
        "/docs/",
        "/openapi.json",
    ];
    PAGES.contains(&path) || path.starts_with("/assets/") || path.starts_with("/grpc.health.v1.Health/")
}
