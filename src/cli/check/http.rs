//! A small HTTP client: one server, one call at a time, whole bodies.

use crate::server::tls::https_connector;
use bytes::Bytes;
use http::{HeaderMap, Method, Request, StatusCode, Uri, header};
use http_body_util::{BodyExt as _, Full, Limited};
use hyper_rustls::HttpsConnector;
use hyper_util::client::legacy::Client as Connections;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Largest answer that is read, bytes.
const LARGEST: usize = 4 << 30;
/// Longest time that one call may take.
const PATIENCE: Duration = Duration::from_secs(900);
/// How often a call is repeated that a busy server turned away.
const TRIES: u32 = 20;
/// Longest wait before it is repeated.
const LONGEST_WAIT: u64 = 10;

/// A server address says where a server is, and who asks.
#[derive(Debug, Clone)]
pub(super) struct ServerAddress {
    base: String,
    token: Option<String>,
    /// PEM file of the authorities that may sign its certificate, in place of the machine's.
    ca: Option<PathBuf>,
}

impl ServerAddress {
    /// Checks a URL such as `http://127.0.0.1:7411`, maybe with a path before the calls' own.
    pub fn new(url: &str, token: Option<&str>, ca: Option<&Path>) -> Result<Self, String> {
        let wrong = |problem: &str| {
            Err(format!(
                "--server is \"{url}\": {problem}, such as http://127.0.0.1:7411"
            ))
        };
        let Ok(uri) = url.parse::<Uri>() else {
            return wrong("it is not a URL; give one");
        };
        match uri.scheme_str() {
            Some("http" | "https") => {}
            _ => return wrong("it must begin with http:// or https://"),
        }
        if uri.query().is_some() || uri.authority().is_none_or(|a| a.as_str().contains('@')) {
            return wrong("it must be host, port and maybe a path");
        }
        if token.is_some_and(|t| t.is_empty() || !t.chars().all(|c| c.is_ascii_graphic())) {
            return Err("--token must be printable ASCII without spaces".into());
        }
        Ok(Self {
            base: url.trim_end_matches('/').to_owned(),
            token: token.map(str::to_owned),
            ca: ca.map(Path::to_owned),
        })
    }
}

/// An HTTP answer is what a server answered.
pub(super) struct HttpAnswer {
    pub headers: HeaderMap,
    pub body: Bytes,
}

/// An HTTP call is what is sent.
pub(super) struct HttpCall<'a> {
    pub method: Method,
    /// Below the server's address, percent-encoded.
    pub path: &'a str,
    /// What the call is named in texts, without anything random.
    pub name: &'a str,
    pub content_type: &'a str,
    pub accept: &'a str,
    pub body: Bytes,
}

/// An HTTP client calls one server. It is owned by one thread.
pub(super) struct HttpClient {
    address: ServerAddress,
    connections: Connections<HttpsConnector<HttpConnector>, Full<Bytes>>,
    runtime: tokio::runtime::Runtime,
}

impl HttpClient {
    /// Makes a client; nothing is sent yet.
    pub fn new(address: &ServerAddress) -> Result<Self, String> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        Ok(Self {
            address: address.clone(),
            connections: Connections::builder(TokioExecutor::new()).build(https_connector(address.ca.as_deref())?),
            runtime: runtime.map_err(|e| format!("cannot start a runtime: {e}"))?,
        })
    }

    /// Sends a call and waits for its answer. A server that is busy is asked again after the time that it names.
    ///
    /// # Errors
    /// What went wrong, with the server's own words where it gave some.
    pub fn send(&self, call: &HttpCall<'_>) -> Result<HttpAnswer, String> {
        let named = |problem: String| format!("{} {}: {problem}", call.method, call.name);
        for _ in 1..TRIES {
            let (status, answer) = self.send_once(call).map_err(named)?;
            let busy = matches!(status, StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE);
            let again = answer
                .headers
                .get(header::RETRY_AFTER)
                .and_then(|v| v.to_str().ok()?.parse::<u64>().ok());
            match again {
                Some(seconds) if busy => {
                    let wait = Duration::from_secs(seconds.clamp(1, LONGEST_WAIT));
                    // The timer is made where the runtime runs.
                    self.runtime.block_on(async { tokio::time::sleep(wait).await });
                }
                _ if status.is_success() => return Ok(answer),
                _ => return Err(named(server_problem(status, &answer.body))),
            }
        }
        let (status, answer) = self.send_once(call).map_err(named)?;
        match status.is_success() {
            true => Ok(answer),
            false => Err(named(server_problem(status, &answer.body))),
        }
    }

    fn send_once(&self, call: &HttpCall<'_>) -> Result<(StatusCode, HttpAnswer), String> {
        let uri = format!("{}{}", self.address.base, call.path);
        let mut request = Request::builder().method(call.method.clone()).uri(uri);
        if !call.content_type.is_empty() {
            request = request.header(header::CONTENT_TYPE, call.content_type);
        }
        if !call.accept.is_empty() {
            request = request.header(header::ACCEPT, call.accept);
        }
        if let Some(token) = &self.address.token {
            request = request.header(header::AUTHORIZATION, format!("Bearer {token}"));
        }
        let request = request.body(Full::new(call.body.clone())).map_err(|e| e.to_string())?;
        let answered = async {
            let response = self.connections.request(request).await.map_err(|e| error_chain(&e))?;
            let (parts, body) = response.into_parts();
            let body = Limited::new(body, LARGEST).collect().await;
            let body = body.map_err(|e| format!("the answer broke off: {e}"))?.to_bytes();
            let answer = HttpAnswer {
                headers: parts.headers,
                body,
            };
            Ok((parts.status, answer))
        };
        self.runtime.block_on(async {
            let patient = tokio::time::timeout(PATIENCE, answered).await;
            patient.unwrap_or_else(|_| Err(format!("no answer within {} s", PATIENCE.as_secs())))
        })
    }
}

/// Writes an error with what caused it.
fn error_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let more = cause.to_string();
        if !text.contains(&more) {
            text += &format!(": {more}");
        }
        next = cause.source();
    }
    text
}

/// Writes what a server says is wrong: the detail of its problem document, or its first words.
fn server_problem(status: StatusCode, body: &[u8]) -> String {
    let document = serde_json::from_slice::<serde_json::Value>(body).ok();
    let detail = document.as_ref().and_then(|d| d.get("detail")?.as_str());
    let words: String = match detail {
        Some(detail) => detail.to_owned(),
        None => String::from_utf8_lossy(body).chars().take(200).collect(),
    };
    format!("{}: {words}", status.as_u16())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_one_of_http_with_or_without_tls() {
        let refused = |url: &str, words: &str| {
            let reported = ServerAddress::new(url, None, None).expect_err(url);
            assert!(reported.contains(words) && reported.contains("--server"), "{reported}");
        };
        assert_eq!(
            ServerAddress::new("http://[::1]:80/pliant/", None, None).map(|a| a.base),
            Ok("http://[::1]:80/pliant".into())
        );
        assert!(ServerAddress::new("https://example.org", None, None).is_ok());
        refused("ftp://example.org", "https://");
        refused("127.0.0.1:7411", "http://");
        refused("http://me:secret@host", "host, port");
        refused("http://a b", "not a URL");
        assert!(
            ServerAddress::new("http://host", Some("a b"), None)
                .expect_err("a space")
                .contains("--token")
        );
    }

    #[test]
    fn a_busy_server_is_asked_again() {
        use std::io::{Read as _, Write as _};
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("an address"));
        let server = std::thread::spawn(move || {
            for answer in ["429 Too Many Requests\r\nretry-after: 1", "200 OK"] {
                let (mut socket, _) = listener.accept().expect("a connection");
                let mut request = Vec::new();
                while !request.ends_with(b"\r\n\r\n") {
                    let mut byte = [0];
                    socket.read_exact(&mut byte).expect("a request");
                    request.extend(byte);
                }
                let answer = format!("HTTP/1.1 {answer}\r\ncontent-length: 2\r\nconnection: close\r\n\r\nok");
                socket.write_all(answer.as_bytes()).expect("an answer");
            }
        });
        let client = HttpClient::new(&ServerAddress::new(&url, None, None).expect("an address")).expect("a client");
        let call = HttpCall {
            method: Method::GET,
            path: "/v1/sessions",
            name: "the sessions",
            content_type: "",
            accept: "",
            body: Bytes::new(),
        };
        assert_eq!(
            client.send(&call).map(|answer| answer.body),
            Ok(Bytes::from_static(b"ok"))
        );
        server.join().expect("both calls came");
    }

    #[test]
    fn what_a_server_says_is_told() {
        let reported = server_problem(
            StatusCode::UNPROCESSABLE_ENTITY,
            br#"{"detail": "handles[0].id: is empty"}"#,
        );
        assert_eq!(reported, "422: handles[0].id: is empty");
        assert_eq!(server_problem(StatusCode::BAD_GATEWAY, b"upstream"), "502: upstream");
    }
}
