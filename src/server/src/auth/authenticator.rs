//! How callers prove who they are, and the one place where requests are authenticated.

use super::jwt::{JwtConfig, JwtVerifier};
use super::tokens::{Principal, TokenEntry, presented_token, token_bearer, unknown_caller};
use arc_swap::ArcSwap;
use http::Request;
use pliant_session::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

/// How callers prove who they are. If it names no way, and clients show no certificates either, every caller is the
/// tenant "default".
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AuthConfig {
    /// The accepted tokens.
    pub tokens: Vec<TokenEntry>,
    /// The file that they were read from; tokens follow it when it changes.
    pub file: Option<PathBuf>,
    /// The issuer whose tokens are accepted.
    pub jwt: Option<JwtConfig>,
}

impl AuthConfig {
    /// Whether the server accepts tokens.
    pub fn accepts_tokens(&self) -> bool {
        !self.tokens.is_empty() || self.jwt.is_some()
    }
}

/// Identifies the callers of requests. Cloning shares its tokens and keys.
#[derive(Clone)]
pub(crate) struct Authenticator(Arc<Credentials>);

struct Credentials {
    tokens: ArcSwap<Vec<TokenEntry>>,
    jwt: Option<JwtVerifier>,
    /// Whether callers must prove who they are. Once they must, they must until the server ends: a list of tokens that was emptied
    /// by mistake does not open the server.
    is_required: AtomicBool,
}

impl Authenticator {
    /// Reads the credentials of `config`; `certificates` is whether clients may show certificates instead.
    ///
    /// # Errors
    /// The file of keys that cannot be used, and why.
    pub fn new(config: &AuthConfig, certificates: bool) -> Result<Self, String> {
        Ok(Self(Arc::new(Credentials {
            is_required: AtomicBool::new(certificates || config.accepts_tokens()),
            tokens: ArcSwap::from_pointee(config.tokens.clone()),
            jwt: config.jwt.as_ref().map(JwtVerifier::new).transpose()?,
        })))
    }

    /// Reloads the keys that tokens are checked with, if they have changed.
    pub async fn follow_keys(&self) {
        if let Some(jwt) = &self.0.jwt {
            jwt.follow().await;
        }
    }

    /// Replaces the tokens; requests from now on are compared with these.
    pub fn replace_tokens(&self, tokens: Vec<TokenEntry>) {
        if !tokens.is_empty() {
            self.0.is_required.store(true, Ordering::Relaxed);
        }
        self.0.tokens.store(Arc::new(tokens));
    }

    /// Records the caller in a request. `certificate` is the caller that the client's certificate names; a token takes
    /// precedence.
    ///
    /// # Errors
    /// `UNAUTHENTICATED` without credentials or with invalid ones, except for public pages. `UNAVAILABLE` where they
    /// cannot be checked now.
    pub async fn admit<B>(&self, request: &mut Request<B>, certificate: Option<&Principal>) -> Result<(), Error> {
        if !self.0.is_required.load(Ordering::Relaxed) {
            request.extensions_mut().insert(Principal::anyone());
            return Ok(());
        }
        if is_public(request.uri().path()) {
            return Ok(());
        }
        let token = presented_token(request)?.map(str::to_owned);
        let principal = match (token, &self.0.jwt, certificate) {
            (Some(token), Some(jwt), _) if JwtVerifier::looks_like_one(&token) => jwt.bearer(&token).await?,
            (Some(token), _, _) => token_bearer(&self.0.tokens.load(), &token, SystemTime::now())?,
            (None, _, Some(caller)) => caller.clone(),
            (None, _, None) => return Err(unknown_caller()),
        };
        request.extensions_mut().insert(principal);
        Ok(())
    }
}

/// Whether a path is public: health, the pages for people with their files, and the description of the API. The page at
/// `/` asks for a token itself. All other paths are closed, also those that do not exist.
fn is_public(path: &str) -> bool {
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
