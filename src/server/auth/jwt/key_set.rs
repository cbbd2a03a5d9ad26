//! The keys that an issuer publishes.

use jsonwebtoken::jwk::{AlgorithmParameters, EllipticCurve, Jwk, KeyOperations, PublicKeyUse};
use jsonwebtoken::{Algorithm, DecodingKey};
use serde::Deserialize;

/// Most keys of a set that are looked at.
const MOST_KEYS: usize = 100;

/// Keys to check signatures with.
#[derive(Clone, Default)]
pub(super) struct KeySet(Vec<SigningKey>);

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
    /// Reads a set. Keys that are for something else, such as encryption, or that nothing here can use are passed over: a set belongs
    /// to its issuer, and may hold keys for others.
    ///
    /// # Errors
    /// What is wrong with it; also a set without any key that can be used.
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

    /// The key of that name for an algorithm; without a name, the only one that it can be.
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
        // A secret that is published is none.
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
