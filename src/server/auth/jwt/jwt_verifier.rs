//! Tokens of one issuer, checked.

use super::jwt_config::{JwtConfig, KeySource};
use super::key_set::KeySet;
use super::key_source::{fetch_keys, read_keys};
use super::ring_verifier;
use crate::server::auth::principal::Principal;
use crate::session::{Error, ErrorCode, Tenant};
use arc_swap::ArcSwapOption;
use jsonwebtoken::errors::ErrorKind;
use jsonwebtoken::{DecodingKey, Header, Validation, decode, decode_header};
use serde_json::{Map, Value};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Mutex;
use tokio::time::Instant;

/// Longest name of a tenant, bytes.
const LONGEST: usize = 256;

/// Checks tokens. Cloning shares the keys.
#[derive(Clone)]
pub(in crate::server) struct JwtVerifier(Arc<BelievedIssuer>);

/// An issuer, and the keys that it published last.
struct BelievedIssuer {
    config: JwtConfig,
    /// None until they could be had for the first time.
    keys: ArcSwapOption<KeySet>,
    fetched: Mutex<Fetched>,
}

/// What is known of fetching keys. Held while they are fetched, so that it is done once for all who wait.
#[derive(Default)]
struct Fetched {
    tried: Option<Instant>,
    text: Vec<u8>,
    told: Option<String>,
}

impl JwtVerifier {
    /// A verifier; keys of a file are read at once, others when they are first needed.
    ///
    /// # Errors
    /// The file and what is wrong with it.
    pub fn new(config: &JwtConfig) -> Result<Self, String> {
        ring_verifier::install();
        let mut fetched = Fetched::default();
        let keys = match &config.keys {
            KeySource::File(path) => {
                let told = |problem: String| format!("cannot use the keys in {}: {problem}", path.display());
                fetched.text = read_keys(path)?.to_vec();
                let keys = KeySet::read(&fetched.text, &config.algorithms).map_err(told)?;
                Some(Arc::new(keys))
            }
            KeySource::Url(..) => None,
        };
        Ok(Self(Arc::new(BelievedIssuer {
            config: config.clone(),
            keys: ArcSwapOption::new(keys),
            fetched: Mutex::new(fetched),
        })))
    }

    /// Whether a token looks like one of these: three parts with points between them.
    pub fn looks_like_one(token: &str) -> bool {
        token.bytes().filter(|b| *b == b'.').count() == 2
    }

    /// The bearer of a token.
    ///
    /// # Errors
    /// `UNAUTHENTICATED` for what does not hold, `UNAVAILABLE` while there are no keys to check it with.
    pub async fn bearer(&self, token: &str) -> Result<Principal, Error> {
        let config = &self.0.config;
        let header = decode_header(token).map_err(|_| refuse("the token cannot be read as a JWT"))?;
        if !config.algorithms.contains(&header.alg) {
            return Err(refuse(format!(
                "the token is signed by {:?}, which is not allowed here",
                header.alg
            )));
        }
        if header.crit.is_some() {
            return Err(refuse(
                "the token's header asks for what this server does not know (crit)",
            ));
        }
        let key = self.key_of(&header).await?;
        let claims = self.claims(token, &header, &key)?;
        let text = |name: &str| claims.get(name).and_then(Value::as_str);
        let tenant = text(&config.tenant_claim)
            .filter(|name| !name.is_empty() && name.len() <= LONGEST && !name.chars().any(char::is_control));
        let Some(tenant) = tenant else {
            let claim = &config.tenant_claim;
            return Err(refuse(format!("the token's claim \"{claim}\" does not name a tenant")));
        };
        let named: String = text("sub")
            .unwrap_or(tenant)
            .chars()
            .filter(|c| !c.is_control())
            .take(LONGEST)
            .collect();
        Ok(Principal {
            tenant: Tenant(tenant.into()),
            name: named.into(),
            reads_metrics: false,
        })
    }

    fn claims(&self, token: &str, header: &Header, key: &DecodingKey) -> Result<Map<String, Value>, Error> {
        let config = &self.0.config;
        let mut rules = Validation::new(header.alg);
        rules.set_issuer(&[&config.issuer]);
        rules.set_audience(&config.audiences);
        rules.set_required_spec_claims(&["exp", "iss", "aud"]);
        rules.validate_nbf = true;
        rules.leeway = config.leeway.as_secs();
        let decoded = decode::<Map<String, Value>>(token, key, &rules).map_err(|error| match error.kind() {
            ErrorKind::ExpiredSignature => refuse("the token has expired"),
            ErrorKind::ImmatureSignature => refuse("the token is not valid yet"),
            ErrorKind::InvalidIssuer => refuse("the token is of another issuer"),
            ErrorKind::InvalidAudience => refuse("the token is for another audience"),
            ErrorKind::MissingRequiredClaim(name) => refuse(format!("the token lacks the claim \"{name}\"")),
            ErrorKind::InvalidSignature => refuse("the token's signature does not hold"),
            _ => refuse("the token cannot be read as a JWT"),
        });
        let claims = decoded?.claims;
        // The library takes a list that has the issuer among others; a token has one.
        match claims.get("iss") == Some(&Value::String(config.issuer.clone())) {
            true => Ok(claims),
            false => Err(refuse("the token is of another issuer")),
        }
    }

    /// The key that a token says it was signed with. One that is not known may be new: the keys are fetched again, but not for
    /// everybody who makes up a name.
    async fn key_of(&self, header: &Header) -> Result<DecodingKey, Error> {
        let id = header.kid.as_deref();
        let find = || {
            let keys = self.0.keys.load();
            keys.as_ref().and_then(|keys| keys.find(id, header.alg).cloned())
        };
        if let Some(key) = find() {
            return Ok(key);
        }
        self.fetch(self.0.config.unknown_key_pause).await;
        if self.0.keys.load().is_none() {
            let pause = self.0.config.unknown_key_pause.as_secs().max(1);
            return Err(Error {
                retry_after_s: Some(u32::try_from(pause).unwrap_or(u32::MAX)),
                ..Error::new(
                    ErrorCode::Unavailable,
                    "the keys to check tokens with are not available now; the server's log says why",
                )
            });
        }
        find().ok_or_else(|| refuse("the token is signed with a key that this server does not know"))
    }

    /// Fetches the keys if that is due: those of a file always, others as often as the configuration says.
    pub async fn follow(&self) {
        let every = match &self.0.config.keys {
            KeySource::File(_) => Duration::ZERO,
            KeySource::Url(..) => self.0.config.refresh,
        };
        self.fetch(every).await;
    }

    /// Fetches the keys unless that was tried within `pause`. A failure keeps the present keys, and is logged once.
    async fn fetch(&self, pause: Duration) {
        let mut fetched = self.0.fetched.lock().await;
        if fetched.tried.is_some_and(|tried| tried.elapsed() < pause) {
            return;
        }
        fetched.tried = Some(Instant::now());
        let outcome = match fetch_keys(&self.0.config.keys).await {
            Ok(text) if fetched.text == text => Ok(None),
            Ok(text) => {
                let keys = KeySet::read(&text, &self.0.config.algorithms);
                fetched.text = text.to_vec();
                keys.map(Some)
                    .map_err(|problem| format!("the keys cannot be used: {problem}"))
            }
            Err(problem) => Err(problem),
        };
        match outcome {
            Ok(None) => {}
            Ok(Some(keys)) => {
                tracing::info!("the keys of tokens were read");
                self.0.keys.store(Some(Arc::new(keys)));
                fetched.told = None;
            }
            Err(problem) if fetched.told.as_ref() == Some(&problem) => {}
            Err(problem) => {
                tracing::error!("the keys of tokens stay as they were: {problem}");
                fetched.told = Some(problem);
            }
        }
    }
}

fn refuse(text: impl Into<String>) -> Error {
    Error::new(ErrorCode::Unauthenticated, text)
}
