//! Which web pages may call: the browser's `Origin` header against the configured list.
//!
//! A page of a foreign origin must not reach a service that listens on a developer's machine. So by default the server's
//! own pages and pages served from the same machine may call, and nothing else; programs send no `Origin` and are not
//! concerned.

use super::hosts::is_this_machine;
use http::{HeaderMap, HeaderValue, Uri, header};

/// The origins that may call.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origins {
    any: bool,
    local: bool,
    listed: Vec<String>,
}

impl Default for Origins {
    fn default() -> Self {
        Self {
            any: false,
            local: true,
            listed: Vec::new(),
        }
    }
}

impl Origins {
    /// Reads a list of origins: `https://example.org`, `localhost` (pages of this machine, any port), `*` (any page).
    ///
    /// # Errors
    /// What was seen and what is allowed.
    pub fn parse(words: &[String]) -> Result<Self, String> {
        let mut origins = Self {
            any: false,
            local: false,
            listed: Vec::new(),
        };
        for word in words {
            match word.as_str() {
                "*" => origins.any = true,
                "localhost" => origins.local = true,
                text => {
                    let plain = text.parse::<Uri>().ok().filter(|uri| {
                        matches!(uri.scheme_str(), Some("http" | "https")) && uri.path() == "/" && uri.query().is_none()
                    });
                    if plain.is_none() || text.ends_with('/') {
                        return Err(format!(
                            "\"{text}\" is not an origin; allowed are scheme and host such as https://example.org, \"localhost\" and \"*\""
                        ));
                    }
                    origins.listed.push(text.to_ascii_lowercase());
                }
            }
        }
        Ok(origins)
    }

    /// Whether any page may call.
    pub fn allow_any(&self) -> bool {
        self.any
    }

    /// Whether a page of `origin` may call a server that is addressed as `host`.
    pub fn allow(&self, origin: &HeaderValue, host: Option<&str>) -> bool {
        if self.any {
            return true;
        }
        let Ok(origin) = origin.to_str() else { return false };
        let origin = origin.to_ascii_lowercase();
        if self.listed.contains(&origin) {
            return true;
        }
        // An origin names no user (RFC 6454): what stands before an @ is not the host.
        let Some((_, authority)) = origin.split_once("://").filter(|(_, rest)| !rest.contains('@')) else {
            return false;
        };
        (self.local && is_local(authority)) || host.is_some_and(|host| host.eq_ignore_ascii_case(authority))
    }

    /// Whether a request with these headers may go on: it names no origin, or one that may call.
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
