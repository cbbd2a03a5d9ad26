//! The token that a request brings.

use crate::session::{Error, ErrorCode};
use http::{HeaderMap, HeaderValue, Method, Request, header};

/// How a WebSocket's sub-protocol begins that is a token. A page cannot give its WebSocket headers, but it can name
/// sub-protocols; an address would end in logs and histories.
const SOCKET_TOKEN: &str = "pliant.bearer.";

/// Longest token that is looked at, bytes.
pub const LONGEST_TOKEN: usize = 16 << 10;

/// The token of a request: of its `Authorization`, or of a sub-protocol `pliant.bearer.TOKEN` where it opens a WebSocket.
///
/// # Errors
/// `UNAUTHENTICATED` for an `Authorization` that is none of a bearer, and where there are two.
pub(super) fn presented_token<B>(request: &Request<B>) -> Result<Option<&str>, Error> {
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
