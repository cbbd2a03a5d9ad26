//! Callers, and the tokens by which they are identified: as a request brings them, and as hashes in a list.

use http::{Extensions, HeaderMap, HeaderValue, Method, Request, header};
use pliant_session::{Error, ErrorCode, Tenant};
use sha2::{Digest as _, Sha256};
use std::fmt;
use std::sync::Arc;
use std::time::SystemTime;
use subtle::ConstantTimeEq as _;

/// An authenticated caller, or any caller of a server without authentication. Travels with the request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Principal {
    /// The tenant whose sessions it sees.
    pub tenant: Tenant,
    /// What it is called in logs: the name of its token, or the name in its certificate. Never a secret.
    pub name: Arc<str>,
    /// Whether it may read the counts of the whole server.
    pub reads_metrics: bool,
}

impl Principal {
    /// Any caller of an open server.
    pub fn anyone() -> Self {
        Self {
            tenant: Tenant::default(),
            name: "anyone".into(),
            reads_metrics: true,
        }
    }

    /// A caller that is called like its tenant.
    pub fn of_tenant(name: &str) -> Self {
        Self {
            tenant: Tenant(name.into()),
            name: name.into(),
            reads_metrics: false,
        }
    }
}

/// The caller of a request.
///
/// # Errors
/// `UNAUTHENTICATED` where the authenticator admitted the request without one, as it does for public pages.
pub(crate) fn principal(extensions: &Extensions) -> Result<&Principal, Error> {
    extensions.get::<Principal>().ok_or_else(unknown_caller)
}

/// Rejects a request without credentials.
pub(crate) fn unknown_caller() -> Error {
    Error::new(
        ErrorCode::Unauthenticated,
        "this server needs a token; send it in the header Authorization: Bearer TOKEN",
    )
}

/// How a WebSocket's sub-protocol begins that is a token. A page cannot give its WebSocket headers, but it can name
/// sub-protocols; an address would end in logs and histories.
const SOCKET_TOKEN: &str = "pliant.bearer.";

/// Longest token that is read, bytes.
pub const LONGEST_TOKEN: usize = 16 << 10;

/// The token of a request: of its `Authorization`, or of a sub-protocol `pliant.bearer.TOKEN` where it opens a WebSocket.
///
/// # Errors
/// `UNAUTHENTICATED` for an `Authorization` that is none of a bearer, and where there are two.
pub(crate) fn presented_token<B>(request: &Request<B>) -> Result<Option<&str>, Error> {
    let headers = request.headers();
    let refuse = |text: &str| Err(Error::new(ErrorCode::Unauthenticated, text));
    let mut values = headers.get_all(header::AUTHORIZATION).iter();
    let token = match (values.next(), values.next()) {
        (Some(_), Some(_)) => return refuse("the request has two Authorization headers, one is allowed"),
        (Some(value), None) => match bearer(value) {
            Some(token) => Some(token),
            None => return refuse("the Authorization header is not \"Bearer TOKEN\""),
        },
        (None, _) if !opens_socket(request) => None,
        (None, _) => {
            let mut tokens = socket_protocols(headers).filter_map(|name| name.strip_prefix(SOCKET_TOKEN));
            match (tokens.next(), tokens.next()) {
                (Some(_), Some(_)) => return refuse("two sub-protocols are tokens, one is allowed"),
                (token, _) => token,
            }
        }
    };
    match token {
        Some(token) if token.is_empty() || token.len() > LONGEST_TOKEN => {
            refuse("the token is empty or longer than 16 KiB")
        }
        token => Ok(token),
    }
}

/// Whether a request opens a WebSocket: by an upgrade, or over HTTP/2 by a CONNECT (RFC 8441).
fn opens_socket<B>(request: &Request<B>) -> bool {
    let upgrade = request.headers().get(header::UPGRADE);
    let is_upgrade = upgrade.is_some_and(|to| to.as_bytes().eq_ignore_ascii_case(b"websocket"));
    is_upgrade || request.method() == Method::CONNECT
}

fn bearer(value: &HeaderValue) -> Option<&str> {
    let (scheme, token) = value.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

fn socket_protocols(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    let values = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL).iter();
    values
        .filter_map(|value| value.to_str().ok())
        .flat_map(|text| text.split(','))
        .map(str::trim)
}

/// An accepted token. It contains the hash of the token, which is of no use to a thief.
#[derive(Clone, PartialEq, Eq)]
pub struct TokenEntry {
    /// The tenant whose sessions its bearer sees.
    pub tenant: Tenant,
    /// SHA-256 of the token's text.
    pub sha256: [u8; 32],
    /// What its bearer is called in logs.
    pub name: String,
    /// The time from which on it is rejected.
    pub expires: Option<SystemTime>,
    /// Whether its bearer may read `/metrics`, which counts for all tenants.
    pub metrics: bool,
}

impl fmt::Debug for TokenEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TokenEntry")
            .field("tenant", &self.tenant.0)
            .field("name", &self.name)
            .field("expires", &self.expires)
            .finish_non_exhaustive()
    }
}

/// Reads a point in time, such as `2027-01-31T12:00:00Z`, or a day, which stands for its beginning in UTC.
pub fn parse_expiry(text: &str) -> Result<SystemTime, String> {
    let day = format!("{text}T00:00:00Z");
    let whole = if text.len() == 10 { &day } else { text };
    humantime::parse_rfc3339_weak(whole)
        .map_err(|_| format!("\"{text}\" is not a time; allowed are 2027-01-31, 2027-01-31T12:00:00Z and the like"))
}

/// The stored form of a token: SHA-256 of its text. Tokens are long and random, so a slow hash would add no protection.
pub fn token_digest(token: &str) -> [u8; 32] {
    Sha256::digest(token.as_bytes()).into()
}

/// The bearer of a token.
///
/// Every entry is compared, each in constant time, so that answers reveal nothing of the list.
///
/// # Errors
/// `UNAUTHENTICATED` for a token that is not in the list, or has expired.
pub(crate) fn token_bearer(entries: &[TokenEntry], token: &str, now: SystemTime) -> Result<Principal, Error> {
    let digest = token_digest(token);
    let mut found = None;
    for entry in entries {
        if bool::from(entry.sha256.ct_eq(&digest)) {
            found = Some(entry);
        }
    }
    let refuse = |text: &str| Err(Error::new(ErrorCode::Unauthenticated, text));
    match found {
        None => refuse("the token is not known to this server, or no longer"),
        Some(entry) if entry.expires.is_some_and(|end| now >= end) => refuse("the token has expired"),
        Some(entry) => Ok(Principal {
            tenant: entry.tenant.clone(),
            name: entry.name.as_str().into(),
            reads_metrics: entry.metrics,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_session::Tenant;
    use std::time::Duration;

    const SOCKET: (&str, &str) = ("upgrade", "WebSocket");

    fn asked(pairs: &[(&'static str, &'static str)]) -> Result<Option<String>, String> {
        let mut request = Request::new(());
        for (name, value) in pairs {
            request.headers_mut().append(*name, HeaderValue::from_static(value));
        }
        let token = presented_token(&request).map_err(|e| e.message)?;
        Ok(token.map(str::to_owned))
    }

    #[test]
    fn a_token_comes_in_a_header_or_as_a_sub_protocol() {
        assert_eq!(asked(&[]), Ok(None));
        assert_eq!(asked(&[("authorization", "bearer abc")]), Ok(Some("abc".into())));
        assert_eq!(
            asked(&[SOCKET, ("sec-websocket-protocol", "pliant.v1, pliant.bearer.a-b_c")]),
            Ok(Some("a-b_c".into()))
        );
        assert_eq!(asked(&[SOCKET, ("sec-websocket-protocol", "pliant.v1")]), Ok(None));
        assert_eq!(
            asked(&[("sec-websocket-protocol", "pliant.bearer.abc")]),
            Ok(None),
            "it opens no socket"
        );
    }

    #[test]
    fn anything_else_is_refused_rather_than_ignored() {
        for pairs in [
            &[("authorization", "Basic YTpi")][..],
            &[("authorization", "Bearer")],
            &[("authorization", "Bearer  ")],
            &[("authorization", "Bearer a"), ("authorization", "Bearer b")],
            &[SOCKET, ("sec-websocket-protocol", "pliant.bearer.")],
            &[SOCKET, ("sec-websocket-protocol", "pliant.bearer.a, pliant.bearer.b")],
        ] {
            assert!(asked(pairs).is_err(), "{pairs:?}");
        }
    }

    fn entry(token: &str, tenant: &str, expires: Option<SystemTime>) -> TokenEntry {
        TokenEntry {
            tenant: Tenant(tenant.into()),
            sha256: token_digest(token),
            name: format!("{tenant}'s"),
            expires,
            metrics: false,
        }
    }

    #[test]
    fn a_token_has_one_bearer_until_it_expires() {
        let noon = SystemTime::UNIX_EPOCH + Duration::from_secs(1_800_000_000);
        let entries = [entry("one", "a", None), entry("two", "b", Some(noon))];
        let asked = |token, now| token_bearer(&entries, token, now);
        assert_eq!(&*asked("one", noon).unwrap().tenant.0, "a");
        assert_eq!(&*asked("two", noon - Duration::from_secs(1)).unwrap().tenant.0, "b");
        for (token, problem) in [
            ("two", "expired"),
            ("three", "not known"),
            ("", "not known"),
            ("One", "not known"),
        ] {
            let refused = asked(token, noon).unwrap_err();
            assert_eq!(refused.code, ErrorCode::Unauthenticated);
            assert!(refused.message.contains(problem), "{token}: {refused:?}");
        }
    }

    #[test]
    fn what_is_kept_is_what_sha256sum_prints() {
        let hex: String = token_digest("abc").iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(hex, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
