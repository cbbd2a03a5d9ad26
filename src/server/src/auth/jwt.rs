//! Tokens that somebody else signs: JSON Web Tokens (RFC 7519) of one issuer, checked with the keys that it publishes (RFC 7517).

use super::tokens::Principal;
use crate::tls::https_connector;
use arc_swap::ArcSwapOption;
use bytes::Bytes;
use http::{StatusCode, Uri};
use http_body_util::{BodyExt as _, Empty, Limited};
use hyper_util::client::legacy::Client;
use hyper_util::rt::TokioExecutor;
use jsonwebtoken::crypto::{self, CryptoProvider, JwtSigner, KeyUtils};
use jsonwebtoken::errors::{self, ErrorKind};
use jsonwebtoken::jwk::{AlgorithmParameters, EllipticCurve, Jwk, KeyOperations, PublicKeyUse};
use jsonwebtoken::signature::{Error as SignatureError, Verifier};
use jsonwebtoken::{Algorithm, DecodingKey, DecodingKeyKind, EncodingKey, Header, Validation, decode, decode_header};
use pliant_session::{Error, ErrorCode, Tenant};
use ring::signature::{self, RsaParameters, RsaPublicKeyComponents, UnparsedPublicKey, VerificationAlgorithm};
use serde::Deserialize;
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Mutex;
use tokio::time::Instant;

/// The issuer whose tokens the server accepts, and which of their claims names the tenant.
#[derive(Debug, Clone, PartialEq)]
pub struct JwtConfig {
    /// Where the issuer's keys are.
    pub keys: KeySource,
    /// The claim `iss` that a token must have.
    pub issuer: String,
    /// The claim `aud` must name one of these.
    pub audiences: Vec<String>,
    /// Accepted algorithms. All have a public key and a private one: a published key must not be one to sign with.
    pub algorithms: Vec<Algorithm>,
    /// The claim that is the tenant.
    pub tenant_claim: String,
    /// By how much clocks may differ when `exp` and `nbf` are checked.
    pub leeway: Duration,
    /// How often keys of an address are fetched.
    pub refresh: Duration,
    /// The shortest time from one fetch for an unknown key to the next.
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
    /// Algorithms that can be accepted. RSA keys have at least 2048 bits.
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

/// Longest name of a tenant, bytes.
const LONGEST_NAME: usize = 256;

/// Checks tokens. Cloning shares the keys.
#[derive(Clone)]
pub(crate) struct JwtVerifier(Arc<Issuer>);

/// An issuer, and the keys that it published last.
struct Issuer {
    config: JwtConfig,
    /// None until they were fetched for the first time.
    keys: ArcSwapOption<KeySet>,
    fetched: Mutex<Fetched>,
}

/// What is known of fetching keys. HeldUpload while they are fetched, so that it is done once for all who wait.
#[derive(Default)]
struct Fetched {
    tried: Option<Instant>,
    text: Vec<u8>,
    last_error: Option<String>,
}

impl JwtVerifier {
    /// A verifier; keys of a file are read at once, others when they are first needed.
    ///
    /// # Errors
    /// The file and what is wrong with it.
    pub fn new(config: &JwtConfig) -> Result<Self, String> {
        use_ring_verifier();
        let mut fetched = Fetched::default();
        let keys = match &config.keys {
            KeySource::File(path) => {
                let unusable = |problem: String| format!("cannot use the keys in {}: {problem}", path.display());
                fetched.text = read_keys(path)?.to_vec();
                let keys = KeySet::read(&fetched.text, &config.algorithms).map_err(unusable)?;
                Some(Arc::new(keys))
            }
            KeySource::Url(..) => None,
        };
        Ok(Self(Arc::new(Issuer {
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
            .filter(|name| !name.is_empty() && name.len() <= LONGEST_NAME && !name.chars().any(char::is_control));
        let Some(tenant) = tenant else {
            let claim = &config.tenant_claim;
            return Err(refuse(format!("the token's claim \"{claim}\" does not name a tenant")));
        };
        let named: String = text("sub")
            .unwrap_or(tenant)
            .chars()
            .filter(|c| !c.is_control())
            .take(LONGEST_NAME)
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

    /// The key that a token says it was signed with. An unknown one may be new: the keys are fetched again, but
    /// not for each invented name.
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
                fetched.last_error = None;
            }
            Err(problem) if fetched.last_error.as_ref() == Some(&problem) => {}
            Err(problem) => {
                tracing::error!("the keys of tokens stay as they were: {problem}");
                fetched.last_error = Some(problem);
            }
        }
    }
}

fn refuse(text: impl Into<String>) -> Error {
    Error::new(ErrorCode::Unauthenticated, text)
}

/// Most keys of a set that are read.
const MOST_KEYS: usize = 100;

/// Keys to check signatures with.
#[derive(Clone, Default)]
struct KeySet(Vec<SigningKey>);

#[derive(Clone)]
struct SigningKey {
    id: Option<String>,
    /// What it may be used for.
    algorithms: Vec<Algorithm>,
    key: DecodingKey,
}

#[derive(Deserialize)]
struct Document {
    keys: Vec<serde_json::Value>,
}

impl KeySet {
    /// Reads a set. Keys that are for something else, such as encryption, or that are of no use here are skipped: a set belongs
    /// to its issuer, and may contain keys for others.
    ///
    /// # Errors
    /// What is wrong with it; also a set without a usable key.
    pub fn read(text: &[u8], allowed: &[Algorithm]) -> Result<Self, String> {
        let document: Document =
            serde_json::from_slice(text).map_err(|e| format!("they are not a JSON Web Key Set: {e}"))?;
        let keys = document.keys.into_iter().take(MOST_KEYS);
        let usable: Vec<SigningKey> = keys.filter_map(|key| signing_key(key, allowed)).collect();
        if usable.is_empty() {
            return Err("none of them can check a signature of an algorithm that is allowed".into());
        }
        Ok(Self(usable))
    }

    /// The key of that name for an algorithm; without a name, the only key for it.
    pub fn find(&self, id: Option<&str>, algorithm: Algorithm) -> Option<&DecodingKey> {
        let mut fitting = (self.0.iter()).filter(|key| key.algorithms.contains(&algorithm));
        match id {
            Some(id) => fitting.find(|key| key.id.as_deref() == Some(id)).map(|key| &key.key),
            None => match (fitting.next(), fitting.next()) {
                (Some(only), None) => Some(&only.key),
                _ => None,
            },
        }
    }
}

fn signing_key(document: serde_json::Value, allowed: &[Algorithm]) -> Option<SigningKey> {
    let jwk: Jwk = serde_json::from_value(document).ok()?;
    let by_kind: &[Algorithm] = match &jwk.algorithm {
        AlgorithmParameters::RSA(_) => &[
            Algorithm::RS256,
            Algorithm::RS384,
            Algorithm::RS512,
            Algorithm::PS256,
            Algorithm::PS384,
            Algorithm::PS512,
        ],
        AlgorithmParameters::EllipticCurve(key) => match key.curve {
            EllipticCurve::P256 => &[Algorithm::ES256],
            EllipticCurve::P384 => &[Algorithm::ES384],
            _ => return None,
        },
        AlgorithmParameters::OctetKeyPair(key) if key.curve == EllipticCurve::Ed25519 => &[Algorithm::EdDSA],
        // A published secret protects nothing.
        _ => return None,
    };
    let about = &jwk.common;
    let is_for_signatures = about
        .public_key_use
        .as_ref()
        .is_none_or(|used| *used == PublicKeyUse::Signature);
    let checks = about
        .key_operations
        .as_ref()
        .is_none_or(|does| does.contains(&KeyOperations::Verify));
    if !is_for_signatures || !checks {
        return None;
    }
    let named = about.key_algorithm.map(|name| name.to_string());
    let fits = |a: &Algorithm| allowed.contains(a) && named.as_ref().is_none_or(|name| *name == format!("{a:?}"));
    let algorithms: Vec<Algorithm> = by_kind.iter().copied().filter(fits).collect();
    let key = DecodingKey::from_jwk(&jwk).ok()?;
    (!algorithms.is_empty()).then_some(SigningKey {
        id: jwk.common.key_id,
        algorithms,
        key,
    })
}

/// Largest set of keys, bytes.
const LARGEST_KEY_SET: usize = 1 << 20;

/// How long fetching it may take.
const FETCH_TIME: Duration = Duration::from_secs(5);

/// Fetches the text of a set of keys.
///
/// # Errors
/// The place, and why it cannot be fetched.
async fn fetch_keys(source: &KeySource) -> Result<Bytes, String> {
    match source {
        KeySource::File(path) => {
            let path = path.clone();
            let read = tokio::task::spawn_blocking(move || read_keys(&path)).await;
            read.map_err(|e| e.to_string())?
        }
        KeySource::Url(url, ca) => {
            let unfetched = |problem: String| format!("cannot fetch the keys at {url}: {problem}");
            let fetched = tokio::time::timeout(FETCH_TIME, fetch_url(url, ca.as_deref())).await;
            let in_time = fetched.unwrap_or_else(|_| Err(format!("no answer within {} s", FETCH_TIME.as_secs())));
            in_time.map_err(unfetched)
        }
    }
}

/// Reads the keys of a file.
///
/// # Errors
/// The file, and why it cannot be read.
fn read_keys(path: &Path) -> Result<Bytes, String> {
    let unreadable = |problem: String| format!("cannot read the keys in {}: {problem}", path.display());
    let facts = std::fs::metadata(path).map_err(|e| unreadable(e.to_string()))?;
    if !facts.is_file() || facts.len() > LARGEST_KEY_SET as u64 {
        return Err(unreadable("a regular file of at most 1 MiB is needed".into()));
    }
    let bytes = std::fs::read(path).map_err(|e| unreadable(e.to_string()))?;
    Ok(bytes.into())
}

/// Follows no redirections: the address that was configured is the one that is trusted.
async fn fetch_url(url: &str, ca: Option<&Path>) -> Result<Bytes, String> {
    let uri: Uri = url.parse().map_err(|_| "it is not an address".to_owned())?;
    let client = Client::builder(TokioExecutor::new()).build::<_, Empty<Bytes>>(https_connector(ca)?);
    let answer = client.get(uri).await.map_err(|e| error_chain(&e))?;
    if answer.status() != StatusCode::OK {
        return Err(format!("it answers {}", answer.status()));
    }
    let body = Limited::new(answer.into_body(), LARGEST_KEY_SET).collect().await;
    let body = body.map_err(|e| format!("the answer is longer than 1 MiB, or broke off: {e}"))?;
    Ok(body.to_bytes())
}

fn error_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        text += &format!(": {cause}");
        next = cause.source();
    }
    text
}

/// Makes [`jsonwebtoken`] check signatures with `ring`, which also does TLS here. Only the first call of a process does anything.
fn use_ring_verifier() {
    static PROVIDER: CryptoProvider = CryptoProvider {
        signer_factory: no_signer,
        verifier_factory: verifier,
        key_utils: KeyUtils::new_unimplemented(),
    };
    let _ = PROVIDER.install_default();
}

fn no_signer(_: &Algorithm, _: &EncodingKey) -> errors::Result<Box<dyn JwtSigner>> {
    Err(ErrorKind::UnsupportedAlgorithm.into())
}

/// Checks signatures of one algorithm with one key.
struct RingVerifier {
    algorithm: Algorithm,
    key: PublicKey,
}

enum PublicKey {
    Rsa(&'static RsaParameters, Vec<u8>, Vec<u8>),
    Other(UnparsedPublicKey<Vec<u8>>),
}

fn verifier(algorithm: &Algorithm, key: &DecodingKey) -> errors::Result<Box<dyn crypto::JwtVerifier>> {
    let rsa = |parameters: &'static RsaParameters| match key.kind() {
        DecodingKeyKind::RsaModulusExponent { n, e } => Ok(PublicKey::Rsa(parameters, n.clone(), e.clone())),
        DecodingKeyKind::SecretOrDer(_) => Err(ErrorKind::InvalidKeyFormat),
    };
    let other = |of: &'static dyn VerificationAlgorithm| match key.kind() {
        DecodingKeyKind::SecretOrDer(bytes) => Ok(PublicKey::Other(UnparsedPublicKey::new(of, bytes.clone()))),
        DecodingKeyKind::RsaModulusExponent { .. } => Err(ErrorKind::InvalidKeyFormat),
    };
    if algorithm.family() != key.family() {
        return Err(ErrorKind::InvalidKeyFormat.into());
    }
    let key = match algorithm {
        Algorithm::RS256 => rsa(&signature::RSA_PKCS1_2048_8192_SHA256)?,
        Algorithm::RS384 => rsa(&signature::RSA_PKCS1_2048_8192_SHA384)?,
        Algorithm::RS512 => rsa(&signature::RSA_PKCS1_2048_8192_SHA512)?,
        Algorithm::PS256 => rsa(&signature::RSA_PSS_2048_8192_SHA256)?,
        Algorithm::PS384 => rsa(&signature::RSA_PSS_2048_8192_SHA384)?,
        Algorithm::PS512 => rsa(&signature::RSA_PSS_2048_8192_SHA512)?,
        Algorithm::ES256 => other(&signature::ECDSA_P256_SHA256_FIXED)?,
        Algorithm::ES384 => other(&signature::ECDSA_P384_SHA384_FIXED)?,
        Algorithm::EdDSA => other(&signature::ED25519)?,
        _ => return Err(ErrorKind::UnsupportedAlgorithm.into()),
    };
    Ok(Box::new(RingVerifier {
        algorithm: *algorithm,
        key,
    }))
}

impl Verifier<Vec<u8>> for RingVerifier {
    fn verify(&self, message: &[u8], signature: &Vec<u8>) -> Result<(), SignatureError> {
        let checked = match &self.key {
            PublicKey::Rsa(parameters, n, e) => RsaPublicKeyComponents { n, e }.verify(parameters, message, signature),
            PublicKey::Other(key) => key.verify(message, signature),
        };
        checked.map_err(|_| SignatureError::new())
    }
}

impl crypto::JwtVerifier for RingVerifier {
    fn algorithm(&self) -> Algorithm {
        self.algorithm
    }
}
