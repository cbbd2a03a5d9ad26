//! Under which names the server may be addressed: the `Host` of a request against the configured list.
//!
//! A web page can let its own name point at this machine and then call the server here as if it were its own (DNS
//! rebinding). Only that name in its requests distinguishes them from valid ones. So a server that listens on this
//! machine alone answers to this machine's names alone.

use crate::session::{Error, ErrorCode};
use http::uri::Authority;
use http::{Request, header};
use std::net::IpAddr;

/// The names under which the server may be addressed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hosts {
    any: bool,
    local: bool,
    listed: Vec<String>,
}

impl Default for Hosts {
    /// The names and addresses of this machine.
    fn default() -> Self {
        Self {
            any: false,
            local: true,
            listed: Vec::new(),
        }
    }
}

impl Hosts {
    /// Every name.
    pub fn any() -> Self {
        Self {
            any: true,
            ..Self::default()
        }
    }

    /// Reads a list: names and addresses without a port, `localhost` for all of this machine's, `*` for any.
    ///
    /// # Errors
    /// What was seen and what is allowed.
    pub fn parse(words: &[String]) -> Result<Self, String> {
        let mut hosts = Self {
            any: false,
            local: false,
            listed: Vec::new(),
        };
        for word in words {
            match word.as_str() {
                "*" => hosts.any = true,
                "localhost" => hosts.local = true,
                text => hosts.listed.push(listed_name(text).ok_or_else(|| {
                    format!(
                        "\"{text}\" is not the name of a host; allowed are names and addresses without a port, such as \
                         mesh.example.org or 192.0.2.7, \"localhost\" and \"*\""
                    )
                })?),
            }
        }
        Ok(hosts)
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
        self.any || (self.local && is_this_machine(&host)) || self.listed.contains(&host)
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
}
