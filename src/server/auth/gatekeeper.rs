//! The one place where requests are let in.

use super::auth_config::{AuthConfig, TokenEntry};
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
    /// Whether callers must say who they are. Once they must, they must until the server ends: a list of tokens that was emptied
    /// by mistake opens nothing.
    asks: AtomicBool,
}

impl Gatekeeper {
    /// Knows what `config` says; `certificates` is whether clients may show certificates instead.
    pub fn new(config: &AuthConfig, certificates: bool) -> Self {
        Self(Arc::new(Known {
            asks: AtomicBool::new(certificates || !config.tokens.is_empty()),
            tokens: ArcSwap::from_pointee(config.tokens.clone()),
        }))
    }

    /// Replaces the tokens; requests from now on are compared with these.
    pub fn replace_tokens(&self, tokens: Vec<TokenEntry>) {
        if !tokens.is_empty() {
            self.0.asks.store(true, Ordering::Relaxed);
        }
        self.0.tokens.store(Arc::new(tokens));
    }

    /// Notes on a request who asks. `shown` is who the connection's certificate says it is; a token counts before it.
    ///
    /// # Errors
    /// `UNAUTHENTICATED` where nobody knows, or what was shown does not hold. Pages that belong to nobody are let in unasked.
    pub fn admit<B>(&self, request: &mut Request<B>, shown: Option<&Principal>) -> Result<(), Error> {
        if !self.0.asks.load(Ordering::Relaxed) {
            request.extensions_mut().insert(Principal::anyone());
            return Ok(());
        }
        if is_open(request.uri().path()) {
            return Ok(());
        }
        let principal = match (presented_token(request.headers())?, shown) {
            (Some(token), _) => token_bearer(&self.0.tokens.load(), token, SystemTime::now())?,
            (None, Some(shown)) => shown.clone(),
            (None, None) => return Err(unknown_caller()),
        };
        request.extensions_mut().insert(principal);
        Ok(())
    }
}

/// Whether a path is the same for everybody: health, the pages for people with their files, and the description of the API. The
/// page at `/` asks for a token by itself. All others are closed, those that do not exist among them.
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
