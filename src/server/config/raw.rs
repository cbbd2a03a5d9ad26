//! The configuration as written: every key optional, from file, environment and flags, the later winning.

use super::Error;
use super::units::{ByteSize, Span, Words};
use figment::providers::{Env, Format as _, Toml};
use figment::value::{Dict, Map, Value};
use figment::{Figment, Metadata, Profile, Provider};
use serde::Deserialize;
use std::path::Path;

/// Every key of the configuration, in the order in which `deploy/config.toml` explains them.
pub const KEYS: [&str; 26] = [
    "listen",
    "threads",
    "upload_bytes",
    "vertices",
    "sessions",
    "memory_bytes",
    "handles",
    "message_bytes",
    "window",
    "ttl",
    "max_ttl",
    "history",
    "solve_ms",
    "streams",
    "drain_deadline",
    "connections",
    "requests_per_connection",
    "header_timeout",
    "keepalive_interval",
    "keepalive_timeout",
    "cors_origins",
    "log",
    "log_format",
    "sample",
    "reflection",
    "metrics",
];

/// The keys as given; `None` leaves the default.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Raw {
    pub listen: Option<String>,
    pub threads: Option<u32>,
    pub upload_bytes: Option<ByteSize>,
    pub vertices: Option<u64>,
    pub sessions: Option<u64>,
    pub memory_bytes: Option<ByteSize>,
    pub handles: Option<u32>,
    pub message_bytes: Option<ByteSize>,
    pub window: Option<u32>,
    pub ttl: Option<Span>,
    pub max_ttl: Option<Span>,
    pub history: Option<u32>,
    pub solve_ms: Option<f64>,
    pub streams: Option<u32>,
    pub drain_deadline: Option<Span>,
    pub connections: Option<u32>,
    pub requests_per_connection: Option<u32>,
    pub header_timeout: Option<Span>,
    pub keepalive_interval: Option<Span>,
    pub keepalive_timeout: Option<Span>,
    pub cors_origins: Option<Words>,
    pub log: Option<String>,
    pub log_format: Option<String>,
    pub sample: Option<bool>,
    pub reflection: Option<bool>,
    pub metrics: Option<bool>,
}

/// The flags of a command line, as (key, text).
pub(super) struct Flags<'a>(pub &'a [(&'static str, String)]);

impl Provider for Flags<'_> {
    fn metadata(&self) -> Metadata {
        Metadata::named("the command line").interpolater(|_, keys| format!("--{}", keys.join("-").replace('_', "-")))
    }

    fn data(&self) -> figment::Result<Map<Profile, Dict>> {
        let read = |text: &str| text.parse::<Value>().unwrap_or_else(|never| match never {});
        let keys: Dict = self
            .0
            .iter()
            .map(|(key, text)| ((*key).to_owned(), read(text)))
            .collect();
        Ok(Map::from([(Profile::Default, keys)]))
    }
}

/// The merged sources, kept so that an error can say where a value came from.
pub(super) struct Sources {
    figment: Figment,
}

impl Sources {
    /// Collects file < environment < flags. A file that was named must exist.
    pub fn collect(file: Option<&Path>, flags: &[(&'static str, String)]) -> Result<Self, Error> {
        let mut figment = Figment::new();
        if let Some(path) = file {
            let text = std::fs::read_to_string(path).map_err(|e| Error::File {
                path: path.display().to_string(),
                problem: e.to_string(),
            })?;
            figment = figment.merge(NamedToml {
                toml: Toml::string(&text),
                path: path.display().to_string(),
            });
        }
        let figment = figment.merge(Env::prefixed("PLIANT_").only(&KEYS)).merge(Flags(flags));
        Ok(Self { figment })
    }

    /// Reads the keys.
    pub fn raw(&self) -> Result<Raw, Error> {
        self.figment.extract().map_err(|error| {
            use figment::error::Kind;
            let key = error.path.join(".");
            let place = match (&error.metadata, &error.kind) {
                (Some(metadata), _) => describe(metadata, &key),
                (None, _) => "the configuration".to_owned(),
            };
            match &error.kind {
                Kind::UnknownField(name, _) => {
                    let file = self
                        .figment
                        .metadata()
                        .next()
                        .map_or_else(|| place.clone(), |m| m.name.to_string());
                    let problem = format!("no such key; allowed are {}", KEYS.join(", "));
                    Error::Value {
                        key: name.clone(),
                        place: if error.metadata.is_some() { place } else { file },
                        problem,
                    }
                }
                kind => Error::Value {
                    key: if key.is_empty() { "(file)".into() } else { key },
                    place,
                    problem: kind.to_string(),
                },
            }
        })
    }

    /// Where the value of `key` came from.
    pub fn place(&self, key: &str) -> String {
        self.figment
            .find_metadata(key)
            .map_or_else(|| "the defaults".to_owned(), |m| describe(m, key))
    }
}

fn describe(metadata: &Metadata, key: &str) -> String {
    if metadata.name.contains("environment") {
        return format!("environment variable PLIANT_{}", key.to_uppercase());
    }
    if metadata.name == "the command line" {
        return format!("flag --{}", key.replace('_', "-"));
    }
    metadata.name.to_string()
}

/// A TOML text that remembers the file it came from.
struct NamedToml {
    toml: figment::providers::Data<Toml>,
    path: String,
}

impl Provider for NamedToml {
    fn metadata(&self) -> Metadata {
        Metadata::named(format!("file {}", self.path))
    }

    fn data(&self) -> figment::Result<Map<Profile, Dict>> {
        self.toml.data()
    }
}

/// Environment variables that look like keys and are none.
pub(super) fn strangers() -> Vec<String> {
    std::env::vars_os()
        .filter_map(|(name, _)| name.into_string().ok())
        .filter(|name| is_stranger(name))
        .collect()
}

fn is_stranger(name: &str) -> bool {
    // Read by the other commands, the Python package, the build, the tests and the workflows, not by the server.
    const OTHERS: [&str; 8] = [
        "PLIANT_BIN",
        "PLIANT_CONFIG",
        "PLIANT_DATA",
        "PLIANT_REPOSITORY",
        "PLIANT_SERVER",
        "PLIANT_TOKEN",
        "PLIANT_VIEWER",
        "PLIANT_VIEWER_PAGE",
    ];
    let key = name.strip_prefix("PLIANT_").map(str::to_lowercase);
    key.is_some_and(|key| !OTHERS.contains(&name) && !KEYS.contains(&key.as_str()))
}

#[cfg(test)]
mod tests {
    use super::is_stranger;

    #[test]
    fn only_what_nothing_reads_is_a_stranger() {
        for known in [
            "PATH",
            "PLIANT_LISTEN",
            "PLIANT_MAX_TTL",
            "PLIANT_BIN",
            "PLIANT_SERVER",
            "PLIANT_TOKEN",
            "PLIANT_VIEWER_PAGE",
        ] {
            assert!(!is_stranger(known), "{known}");
        }
        for stranger in ["PLIANT_LISTENS", "PLIANT_", "PLIANT_BINS"] {
            assert!(is_stranger(stranger), "{stranger}");
        }
    }
}
