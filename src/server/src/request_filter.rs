//! Whether a request may enter at all: by the name that addresses the server (`Host`), and by the page that sends it
//! (`Origin`). It is checked before anything else.
//!
//! A web page can let its own name point at this machine and then call the server here as if it were its own (DNS
//! rebinding). Only that name in its requests distinguishes them from valid ones. So a server that listens on this
//! machine alone answers to this machine's names alone.
//!
//! A page of a foreign origin must not reach a service that listens on a developer's machine. So by default the server's
//! own pages and pages served from the same machine may call, and nothing else; programs send no `Origin` and are not
//! concerned.

use http::uri::Authority;
use http::{HeaderMap, HeaderValue, Request, Uri, header};
use pliant_session::{Error, ErrorCode};
use std::net::IpAddr;

/// Travels with a request that is rejected, so that it is numbered, counted and answered like any other.
#[derive(Debug, Clone)]
pub(super) struct Rejected(pub Error);

/// Why a request may not enter; `None` where it may. A page can do harm without reading the answer: all methods are treated alike.
pub(super) fn reject<B>(request: &Request<B>, hosts: &Hosts, origins: &Origins) -> Option<Rejected> {
    if let Err(error) = hosts.check(request) {
        return Some(Rejected(error));
    }
    let is_embedded = is_embedded(request) && !origins.allow_any();
    if origins.admit(request.headers(), request.uri()) && !is_embedded {
        return None;
    }
    let problem = "pages of this origin may not call; the key cors_origins lists who may";
    Some(Rejected(Error::new(ErrorCode::PermissionDenied, problem)))
}

/// Whether a page of another site embeds the answer, as an image or a frame: browsers name no origin then, but say that much
/// (`Sec-Fetch-Site`). Following a link from there is not embedding.
fn is_embedded<B>(request: &Request<B>) -> bool {
    let headers = request.headers();
    let says = |name: &str, value: &str| headers.get(name).is_some_and(|v| v.as_bytes() == value.as_bytes());
    let follows_link = says("sec-fetch-mode", "navigate") && says("sec-fetch-dest", "document");
    says("sec-fetch-site", "cross-site") && !headers.contains_key(header::ORIGIN) && !follows_link
}

/// What is allowed: everything, what is on this machine, or what is listed.
#[derive(Debug, Clone, PartialEq, Eq)]
struct AllowList {
    any: bool,
    local: bool,
    listed: Vec<String>,
}

impl AllowList {
    /// What is on this machine.
    const LOCAL: Self = Self {
        any: false,
        local: true,
        listed: Vec::new(),
    };

    /// Reads a list with `*` for everything and `localhost` for this machine; `read` reads the other words.
    fn parse(words: &[String], read: impl Fn(&str) -> Result<String, String>) -> Result<Self, String> {
        let mut list = Self {
            local: false,
            ..Self::LOCAL
        };
        for word in words {
            match word.as_str() {
                "*" => list.any = true,
                "localhost" => list.local = true,
                text => list.listed.push(read(text)?),
            }
        }
        Ok(list)
    }
}

/// The names under which the server may be addressed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hosts(AllowList);

impl Default for Hosts {
    /// The names and addresses of this machine.
    fn default() -> Self {
        Self(AllowList::LOCAL)
    }
}

impl Hosts {
    /// Every name.
    pub fn any() -> Self {
        Self(AllowList {
            any: true,
            ..AllowList::LOCAL
        })
    }

    /// Reads a list: names and addresses without a port, `localhost` for all of this machine's, `*` for any.
    ///
    /// # Errors
    /// What was seen and what is allowed.
    pub fn parse(words: &[String]) -> Result<Self, String> {
        let read = |text: &str| {
            listed_name(text).ok_or_else(|| {
                format!(
                    "\"{text}\" is not the name of a host; allowed are names and addresses without a port, such as \
                     mesh.example.org or 192.0.2.7, \"localhost\" and \"*\""
                )
            })
        };
        AllowList::parse(words, read).map(Self)
    }

    /// Checks that a request names this server.
    ///
    /// # Errors
    /// [`ErrorCode::InvalidArgument`] for no `Host`, for two, or for an invalid one; [`ErrorCode::PermissionDenied`]
    /// for a name that is not the server's.
    pub fn check<B>(&self, request: &Request<B>) -> Result<(), Error> {
        let mut named = request.headers().get_all(header::HOST).iter();
        let from_header = match (named.next(), named.next()) {
            (Some(_), Some(_)) => return Err(Error::malformed("the request has two Host headers, one is allowed")),
            (Some(host), None) => {
                let text = host.to_str().ok().filter(|text| !text.contains('@'));
                let read = text.and_then(|text| text.parse::<Authority>().ok());
                Some(read.ok_or_else(|| Error::malformed("the Host header is not a host with or without a port"))?)
            }
            (None, _) => None,
        };
        let authorities = [from_header.as_ref(), request.uri().authority()];
        if authorities == [None, None] {
            return Err(Error::malformed("the request has no Host header, one is required"));
        }
        match authorities.into_iter().flatten().find(|a| !self.allow(a.host())) {
            Some(other) => Err(Error::new(
                ErrorCode::PermissionDenied,
                format!(
                    "this server is not \"{}\"; the key hosts lists its names",
                    other.host().chars().take(100).collect::<String>()
                ),
            )),
            None => Ok(()),
        }
    }

    /// Whether a host, without its port, is one of the server's names.
    fn allow(&self, host: &str) -> bool {
        let host = plain(host);
        self.0.any || (self.0.local && is_this_machine(&host)) || self.0.listed.contains(&host)
    }
}

/// A host in lower case, without the brackets of an IPv6 address and the dot at the end of a full name.
fn plain(host: &str) -> String {
    let inside = host.strip_prefix('[').and_then(|h| h.strip_suffix(']'));
    let host = inside.unwrap_or(host).to_ascii_lowercase();
    match host.parse::<IpAddr>() {
        Ok(address) => address.to_canonical().to_string(),
        Err(_) => host.strip_suffix('.').map_or(host.clone(), str::to_owned),
    }
}

fn listed_name(text: &str) -> Option<String> {
    if text.parse::<IpAddr>().is_ok() {
        return Some(plain(text));
    }
    let authority: Authority = text.parse().ok()?;
    let is_alone = authority.host() == text && !text.is_empty() && !text.contains('*');
    is_alone.then(|| plain(text))
}

/// Whether a host is a name or an address of the machine that it is used on.
pub(super) fn is_this_machine(host: &str) -> bool {
    match host.parse::<IpAddr>() {
        Ok(address) => address.to_canonical().is_loopback(),
        Err(_) => host == "localhost" || host.ends_with(".localhost"),
    }
}

/// The origins whose pages may call; by default those of this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origins(AllowList);

impl Default for Origins {
    fn default() -> Self {
        Self(AllowList::LOCAL)
    }
}

impl Origins {
    /// Reads a list of origins: `https://example.org`, `localhost` (pages of this machine, any port), `*` (any page).
    ///
    /// # Errors
    /// What was seen and what is allowed.
    pub fn parse(words: &[String]) -> Result<Self, String> {
        let read = |text: &str| {
            let is_origin = text.parse::<Uri>().is_ok_and(|uri| {
                matches!(uri.scheme_str(), Some("http" | "https")) && uri.path() == "/" && uri.query().is_none()
            });
            match is_origin && !text.ends_with('/') {
                true => Ok(text.to_ascii_lowercase()),
                false => Err(format!(
                    "\"{text}\" is not an origin; allowed are scheme and host such as https://example.org, \"localhost\" and \"*\""
                )),
            }
        };
        AllowList::parse(words, read).map(Self)
    }

    /// Whether any page may call.
    fn allow_any(&self) -> bool {
        self.0.any
    }

    /// Whether a page of `origin` may call a server that is addressed as `host`.
    fn allow(&self, origin: &HeaderValue, host: Option<&str>) -> bool {
        if self.0.any {
            return true;
        }
        let Ok(origin) = origin.to_str() else { return false };
        let origin = origin.to_ascii_lowercase();
        if self.0.listed.contains(&origin) {
            return true;
        }
        // An origin names no user (RFC 6454): what stands before an @ is not the host.
        let Some((_, authority)) = origin.split_once("://").filter(|(_, rest)| !rest.contains('@')) else {
            return false;
        };
        (self.0.local && is_local(authority)) || host.is_some_and(|host| host.eq_ignore_ascii_case(authority))
    }

    /// Whether a request with these headers may enter: it names no origin, or one that may call.
    pub fn admit(&self, headers: &HeaderMap, uri: &Uri) -> bool {
        let Some(origin) = headers.get(header::ORIGIN) else {
            return true;
        };
        let host = headers.get(header::HOST).and_then(|h| h.to_str().ok());
        self.allow(origin, host.or_else(|| uri.authority().map(|a| a.as_str())))
    }
}

fn is_local(authority: &str) -> bool {
    let host = match authority.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => authority.split(':').next().unwrap_or_default(),
    };
    is_this_machine(host)
}

#[cfg(test)]
mod tests {
    use super::*;
    use http::StatusCode;

    fn asked(hosts: &Hosts, host: &[&str]) -> Option<ErrorCode> {
        let request = host.iter().fold(Request::get("/"), |r, host| r.header("host", *host));
        hosts.check(&request.body(()).unwrap()).err().map(|e| e.code)
    }

    #[test]
    fn by_default_names_of_this_machine_are_answered_to_with_any_port() {
        let ours = Hosts::default();
        for host in [
            "localhost",
            "LOCALHOST:7411",
            "localhost.:1",
            "mesh.localhost",
            "127.0.0.1:7411",
            "127.8.8.8",
            "[::1]:7411",
            "[::ffff:127.0.0.1]",
        ] {
            assert_eq!(asked(&ours, &[host]), None, "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:7411",
            "localhost.evil.example",
            "192.168.0.9",
            "127.0.0.1.evil.example",
            "[2001:db8::1]:7411",
        ] {
            assert_eq!(asked(&ours, &[host]), Some(ErrorCode::PermissionDenied), "{host}");
        }
    }

    #[test]
    fn a_request_says_once_to_whom_it_goes() {
        for hosts in [Hosts::default(), Hosts::any()] {
            let malformed = Some(ErrorCode::InvalidArgument { malformed: true });
            assert_eq!(malformed.map(|c| c.http()), Some(StatusCode::BAD_REQUEST.as_u16()));
            assert_eq!(asked(&hosts, &[]), malformed);
            assert_eq!(asked(&hosts, &["localhost", "localhost"]), malformed);
            assert_eq!(asked(&hosts, &["a b"]), malformed);
            assert_eq!(asked(&hosts, &[""]), malformed);
        }
        let named_twice = Request::get("http://localhost/")
            .header("host", "evil.example")
            .body(());
        assert!(Hosts::default().check(&named_twice.unwrap()).is_err());
    }

    #[test]
    fn listed_names_are_compared_whole() {
        let words = ["mesh.example.org".to_owned(), "2001:DB8::1".to_owned()];
        let listed = Hosts::parse(&words).unwrap();
        assert_eq!(asked(&listed, &["Mesh.Example.org:443"]), None);
        assert_eq!(asked(&listed, &["[2001:db8:0::1]:443"]), None);
        assert!(asked(&listed, &["example.org"]).is_some());
        assert!(asked(&listed, &["localhost"]).is_some());
        for word in [
            "mesh.example.org:443",
            "https://a.example",
            "a/b",
            "",
            "*.example.org",
            "a b",
        ] {
            let refused = Hosts::parse(&[word.to_owned()]).unwrap_err();
            assert!(refused.contains("allowed are"), "{word}: {refused}");
        }
    }

    fn allow(words: &[&str], origin: &str, host: Option<&str>) -> bool {
        let words: Vec<String> = words.iter().map(|w| (*w).to_owned()).collect();
        Origins::parse(&words)
            .unwrap()
            .allow(&HeaderValue::from_str(origin).unwrap(), host)
    }

    #[test]
    fn by_default_pages_of_this_machine_and_of_the_server_may_call() {
        let ours = Origins::default();
        let from = |origin: &'static str, host| ours.allow(&HeaderValue::from_static(origin), host);
        assert!(from("http://localhost:5173", None));
        assert!(from("http://[::1]:5173", None));
        assert!(from("https://mesh.example.org", Some("mesh.example.org")));
        assert!(!from("https://evil.example", Some("mesh.example.org")));
        assert!(!from("http://localhost.evil.example", None));
        assert!(!from("null", None));
        assert!(!from("http://localhost:80@evil.example", None));
        assert!(!from("http://a@localhost", None));
    }

    #[test]
    fn listed_origins_are_compared_whole() {
        assert!(allow(&["https://a.example"], "https://a.example", None));
        assert!(!allow(&["https://a.example"], "https://a.example.evil", None));
        assert!(!allow(&["https://a.example"], "http://localhost:1", None));
        assert!(allow(&["*"], "https://anything.example", None));
    }

    #[test]
    fn a_word_that_is_no_origin_is_refused() {
        for word in [
            "example.org",
            "https://example.org/path",
            "https://example.org/",
            "ftp://example.org",
        ] {
            assert!(
                Origins::parse(&[word.to_owned()]).unwrap_err().contains("allowed are"),
                "{word}"
            );
        }
    }
}
