//! The checked settings of `pliant serve`.

use super::Error;
use super::keys::{ConfigKeys, KeyValue};
use super::server_config::ServerConfig;
use super::server_config::node_identity;
use super::server_config::session_config_from_keys;
use super::sources::MergedKeys;
use super::sources::no_address;
use crate::auth::JwtVerifier;
use crate::tls::TlsAcceptor;
use pliant_session::store::StoreLocation;
use std::net::SocketAddr;
use std::path::Path;

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The checked settings of `pliant serve`.
#[derive(Debug, Clone)]
pub struct ServeSettings {
    /// Where to listen.
    pub listen: SocketAddr,
    /// How connections are treated.
    pub server: ServerConfig,
    /// Limits and times of sessions.
    pub session: pliant_session::SessionConfig,
    /// Which log lines are written, as directives such as `info,pliant=debug`.
    pub log: String,
    /// How they look.
    pub log_format: LogFormat,
    /// The collector that spans are sent to, if any.
    pub otlp_endpoint: Option<String>,
    /// Where sessions are kept; `None`: in memory alone.
    pub store: Option<StoreLocation>,
    /// Whether files are decoded by C and C++ in a process of its own only; `None`: where that can be had.
    pub parse_apart: Option<bool>,
    /// Whether a session with the built-in creature is opened at the start.
    pub sample: bool,
    /// What should be said about the configuration once logs are open.
    pub remarks: Vec<String>,
}

impl ServeSettings {
    /// Reads and checks the configuration: `file`, then the environment, then `flags`.
    ///
    /// # Errors
    /// [`Error`] with the key, its source and what is allowed.
    pub fn load(file: Option<&Path>, flags: &ConfigKeys) -> Result<Self, Error> {
        let merged = MergedKeys::collect(file, flags)?;
        let keys = &merged.keys;
        let refuse = |key: &str, problem: String| merged.refuse(key, problem);
        let listen = KeyValue::read(&keys.listen).unwrap_or_else(|| "127.0.0.1:7411".to_owned());
        let listen: SocketAddr = (listen.parse()).map_err(|_| refuse("listen", no_address(&listen)))?;
        let session = session_config_from_keys(&merged)?;
        let server = ServerConfig::from_keys(&merged, listen.ip(), file)?;
        server
            .check_address(listen.ip())
            .map_err(|problem| refuse("listen", problem))?;
        if let Some(jwt) = &server.auth.jwt {
            JwtVerifier::new(jwt).map_err(|problem| refuse("auth.jwt.jwks", problem))?;
        }
        if let Some(tls) = &server.tls {
            TlsAcceptor::open(tls).map_err(|problem| refuse("tls_certificate", problem))?;
        }
        let log = KeyValue::read(&keys.log).unwrap_or_else(|| "info".to_owned());
        tracing_subscriber::EnvFilter::builder().parse(&log).map_err(|e| {
            refuse(
                "log",
                format!("\"{log}\": {e}; allowed are directives such as info or info,pliant=debug"),
            )
        })?;
        let log_format = match KeyValue::read(&keys.log_format).as_deref() {
            None | Some("text") => LogFormat::Text,
            Some("json") => LogFormat::Json,
            Some(other) => {
                return Err(refuse(
                    "log_format",
                    format!("\"{other}\" is not known; allowed are text and json"),
                ));
            }
        };
        let mut remarks = Vec::new();
        if !listen.ip().to_canonical().is_loopback() && server.tls.is_none() {
            remarks.push("what clients send is not encrypted, tokens among it; set tls_certificate and tls_key, or let a proxy do it".into());
        }
        Ok(Self {
            listen,
            server,
            session,
            log,
            log_format,
            otlp_endpoint: otlp_endpoint(&merged)?,
            store: store_location(&merged)?,
            parse_apart: KeyValue::read(&keys.parse_apart),
            sample: KeyValue::read(&keys.sample).unwrap_or(false),
            remarks,
        })
    }
}

/// Where sessions are kept as file, environment and flags say, if they are.
///
/// # Errors
/// As [`ServeSettings::load`].
pub fn stored_in(file: Option<&Path>, flags: &ConfigKeys) -> Result<Option<StoreLocation>, Error> {
    store_location(&MergedKeys::collect(file, flags)?)
}

/// The collector of spans, if there is one.
fn otlp_endpoint(merged: &MergedKeys) -> Result<Option<String>, Error> {
    let Some(url) = KeyValue::read(&merged.keys.otlp_endpoint).filter(|url| !url.is_empty()) else {
        return Ok(None);
    };
    let parsed = url.parse::<http::Uri>().ok();
    if parsed.is_some_and(|uri| uri.scheme_str() == Some("http") && uri.host().is_some_and(|host| !host.is_empty())) {
        return Ok(Some(url));
    }
    let problem = format!(
        "\"{url}\" is not the address of a collector; allowed is http:// with a host and a port, such as http://127.0.0.1:4317"
    );
    Err(merged.refuse("otlp_endpoint", problem))
}

/// Where sessions are kept, if they are.
fn store_location(merged: &MergedKeys) -> Result<Option<StoreLocation>, Error> {
    let said = |key: &Option<KeyValue<String>>| KeyValue::read(key).filter(|text| !text.is_empty());
    let keys = &merged.keys;
    let location = StoreLocation {
        data_dir: said(&keys.data_dir).map(Into::into),
        database: said(&keys.database),
        objects: said(&keys.objects),
        build: None,
        node: node_identity(merged)?,
    };
    let lacks = |key: &str, other: &str| {
        let problem = format!("{key} alone keeps no sessions; set data_dir or {other} as well");
        Err(merged.refuse(key, problem))
    };
    if location.node.is_some() && (location.database.is_none() || location.objects.is_none()) {
        let problem = "nodes share a database and a place of objects; set both database and objects";
        return Err(merged.refuse("advertise", problem.into()));
    }
    match (&location.data_dir, &location.database, &location.objects) {
        (None, None, None) => Ok(None),
        (None, Some(_), None) => lacks("database", "objects"),
        (None, None, Some(_)) => lacks("objects", "database"),
        _ => Ok(Some(location)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args as _, FromArgMatches as _};
    use std::io::Write as _;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    fn load(text: &str, flags: &[(&'static str, &str)]) -> Result<ServeSettings, Error> {
        let file = file(text);
        let flags = flags
            .iter()
            .map(|(key, value)| format!("--{}={value}", key.replace('_', "-")));
        let command = ConfigKeys::augment_args(clap::Command::new("serve").no_binary_name(true));
        let flags = ConfigKeys::from_arg_matches(&command.get_matches_from(flags)).unwrap();
        ServeSettings::load(Some(file.path()), &flags)
    }

    #[test]
    fn flags_win_over_the_file_and_the_file_over_the_defaults() {
        let settings = load(
            "upload_bytes = \"64MiB\"\nsessions = 3\n",
            &[("sessions", "5"), ("listen", "[::1]:9")],
        )
        .unwrap();
        assert_eq!(settings.session.upload_bytes, 64 << 20);
        assert_eq!(settings.session.sessions, 5);
        assert_eq!(settings.listen, "[::1]:9".parse().unwrap());
        assert_eq!(
            settings.session.history,
            pliant_session::SessionConfig::default().history
        );
    }

    #[test]
    fn texts_stay_as_they_were_written() {
        let folder = |flag: &str| {
            load("", &[("data_dir", flag)])
                .unwrap()
                .store
                .unwrap()
                .data_dir
                .unwrap()
        };
        for name in ["007", "3", "true", "[x]", "1e5"] {
            assert_eq!(folder(name), Path::new(name));
        }
        let hosts = load("", &[("hosts", "a.example.org, 10.0.0.1")]).unwrap().server.hosts;
        assert_eq!(
            hosts,
            load("", &[("hosts", "[a.example.org, 10.0.0.1]")])
                .unwrap()
                .server
                .hosts
        );
    }

    #[test]
    fn every_error_names_key_source_and_what_is_allowed() {
        type Case<'a> = (&'a str, &'a [(&'static str, &'a str)], &'a [&'a str]);
        let cases: [Case<'_>; 21] = [
            (
                "",
                &[("listen", "7412")],
                &["listen: 7412 is not an address; write", "127.0.0.1:7412", "--listen"],
            ),
            (
                "listen = 7412",
                &[],
                &["listen: 7412 is not an address; write", "127.0.0.1:7412", "file "],
            ),
            (
                "",
                &[("sessions", "five")],
                &["sessions: is \"five\", a whole number from 0 is allowed", "--sessions"],
            ),
            (
                "sample = \"maybe\"",
                &[],
                &["sample: is \"maybe\", true or false is allowed"],
            ),
            (
                "[quotas]\nsessions = [2]",
                &[],
                &["quotas.sessions: is a list, a whole number from 0 is allowed"],
            ),
            ("sessions = 3\nwindow = ", &[], &["line 2, column 10: ", "file "]),
            (
                "upload_bytes = \"many\"",
                &[],
                &["upload_bytes", "\"many\"", "KiB", "file "],
            ),
            ("sessions = 0", &[], &["sessions", "is 0", "at least 1", "file "]),
            ("", &[("ttl", "15")], &["ttl", "unit", "--ttl"]),
            ("", &[("max_ttl", "5s"), ("ttl", "10s")], &["ttl", "--ttl"]),
            (
                "",
                &[("listen", "localhost")],
                &["listen", "localhost is not an address", "127.0.0.1:7411", "--listen"],
            ),
            (
                "",
                &[("otlp_endpoint", "collector:4317")],
                &[
                    "otlp_endpoint",
                    "\"collector:4317\"",
                    "http://127.0.0.1:4317",
                    "--otlp-endpoint",
                ],
            ),
            (
                "",
                &[("log_format", "xml")],
                &["log_format", "\"xml\"", "text and json", "--log-format"],
            ),
            ("", &[("log", "pliant=loud")], &["log", "allowed are", "--log"]),
            (
                "",
                &[("connections", "0")],
                &["connections", "1 to 1000000", "--connections"],
            ),
            (
                "",
                &[("drain_deadline", "9h")],
                &["drain_deadline", "9h", "1h", "--drain-deadline"],
            ),
            (
                "cors_origins = [\"example.org\"]",
                &[],
                &["cors_origins", "example.org", "https://example.org", "file "],
            ),
            (
                "hosts = [\"mesh.example.org:443\"]",
                &[],
                &["hosts", "mesh.example.org:443", "without a port", "file "],
            ),
            (
                "database = \"postgres://me:secret@db/pliant\"",
                &[],
                &["database", "data_dir", "objects", "file "],
            ),
            (
                "",
                &[("objects", "s3://bucket")],
                &["objects", "data_dir", "database", "--objects"],
            ),
            ("sessons = 4", &[], &["sessons", "no such key", "sessions", "file "]),
        ];
        for (text, flags, parts) in cases {
            let said = load(text, flags).unwrap_err().to_string();
            for part in parts {
                assert!(said.contains(part), "{said:?} lacks {part:?}");
            }
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = ServeSettings::load(Some(Path::new("/nowhere/pliant.toml")), &ConfigKeys::default()).unwrap_err();
        assert!(error.to_string().contains("/nowhere/pliant.toml"));
    }

    #[test]
    fn the_deployed_file_sets_every_key_to_its_default() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/config.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        // Keys stand there commented out, so that the file also works as it is.
        let active: String = text
            .lines()
            .map(|l| l.strip_prefix("#= ").unwrap_or(l))
            .fold(String::new(), |a, l| a + l + "\n");
        for key in ConfigKeys::names() {
            assert!(
                active.lines().any(|l| l.starts_with(&format!("{key} = "))),
                "{key} is not explained in deploy/config.toml"
            );
        }
        let mut deployed = load(&active, &[]).unwrap();
        let mut defaults = load("", &[]).unwrap();
        // Each was read from a file of its own.
        assert!(deployed.server.auth.file.take().is_some() && defaults.server.auth.file.take().is_some());
        assert_eq!(
            (deployed.listen, &deployed.server, &deployed.session),
            (defaults.listen, &defaults.server, &defaults.session)
        );
        assert_eq!(
            (deployed.log, deployed.log_format, deployed.sample, deployed.store),
            (defaults.log, defaults.log_format, defaults.sample, defaults.store)
        );
    }
}
