//! What the server is told before it starts: raw keys from file, environment and flags, checked into typed values.
//!
//! Precedence: defaults < file < environment (`PLIANT_` and the key in capitals) < flags. An unknown key of a file is an
//! error; every error names the key, where its value came from, and what is allowed.

mod raw;
mod units;

pub use raw::KEYS;

use super::origin::Origins;
use crate::session;
use std::{net::SocketAddr, path::Path, time::Duration};

/// Why a configuration cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read configuration file {path}: {problem}")]
    File {
        /// As given.
        path: String,
        /// What the operating system said.
        problem: String,
    },
    /// A key has a value that is not allowed, or does not exist.
    #[error("{key}: {problem} ({place})")]
    Value {
        /// The key.
        key: String,
        /// Where the value came from.
        place: String,
        /// What was seen and what is allowed.
        problem: String,
    },
}

/// How connections are treated. Read by [`run`](super::run); sessions have a configuration of their own.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Connections held at a time; one more is told to come back later.
    pub connections: u32,
    /// HTTP/2 streams of one connection at a time.
    pub requests_per_connection: u32,
    /// How long a connection may take to send a request's head.
    pub header_timeout: Duration,
    /// Silence after which HTTP/2 and WebSocket peers are asked for a sign of life.
    pub keepalive_interval: Duration,
    /// How long that sign of life may take.
    pub keepalive_timeout: Duration,
    /// From the wish to stop until everything still open is dropped.
    pub drain_deadline: Duration,
    /// Browser origins that may call.
    pub origins: Origins,
    /// Whether gRPC reflection answers.
    pub reflection: bool,
    /// Whether `/metrics` answers.
    pub metrics: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            connections: 4096,
            requests_per_connection: 64,
            header_timeout: Duration::from_secs(10),
            keepalive_interval: Duration::from_secs(30),
            keepalive_timeout: Duration::from_secs(20),
            drain_deadline: Duration::from_secs(10),
            origins: Origins::default(),
            reflection: true,
            metrics: true,
        }
    }
}

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// Everything that `pliant serve` needs, checked.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Where to listen.
    pub listen: SocketAddr,
    /// How connections are treated.
    pub server: Config,
    /// Limits and times of sessions.
    pub session: session::Config,
    /// Which log lines are written, as directives such as `info,pliant=debug`.
    pub log: String,
    /// How they look.
    pub log_format: LogFormat,
    /// Whether a session with the built-in creature is opened at the start.
    pub sample: bool,
    /// What should be said about the configuration once logs are open.
    pub remarks: Vec<String>,
}

impl Settings {
    /// Reads and checks the configuration: `file`, then the environment, then `flags` as (key, text).
    ///
    /// # Errors
    /// [`Error`] with the key, its source and what is allowed.
    pub fn load(file: Option<&Path>, flags: &[(&'static str, String)]) -> Result<Self, Error> {
        let sources = raw::Sources::collect(file, flags)?;
        let raw = sources.raw()?;
        let refuse = |key: &str, problem: String| Error::Value {
            key: key.to_owned(),
            place: sources.place(key),
            problem,
        };

        let listen = raw.listen.as_deref().unwrap_or("127.0.0.1:7411");
        let listen: SocketAddr = listen.parse().map_err(|_| {
            refuse("listen", format!("\"{listen}\" is not an address; allowed are an IP address and a port, such as 127.0.0.1:7411 or [::]:7411"))
        })?;
        let session = session_config(&raw, &refuse)?;
        let server = server_config(&raw, &refuse)?;
        let log = raw.log.clone().unwrap_or_else(|| "info".to_owned());
        tracing_subscriber::EnvFilter::builder().parse(&log).map_err(|e| {
            refuse(
                "log",
                format!("\"{log}\": {e}; allowed are directives such as info or info,pliant=debug"),
            )
        })?;
        let log_format = match raw.log_format.as_deref() {
            None | Some("text") => LogFormat::Text,
            Some("json") => LogFormat::Json,
            Some(other) => {
                return Err(refuse(
                    "log_format",
                    format!("\"{other}\" is not known; allowed are text and json"),
                ));
            }
        };
        let remarks = raw::strangers()
            .into_iter()
            .map(|name| format!("environment variable {name} is no configuration key and was ignored"))
            .collect();
        Ok(Self {
            listen,
            server,
            session,
            log,
            log_format,
            sample: raw.sample.unwrap_or(false),
            remarks,
        })
    }
}

fn server_config(raw: &raw::Raw, refuse: &impl Fn(&str, String) -> Error) -> Result<Config, Error> {
    let mut config = Config::default();
    let count = |key: &str, value: Option<u32>, default: u32, highest: u32| match value {
        Some(value) if value == 0 || value > highest => Err(refuse(
            key,
            format!("{value} is out of range; allowed are 1 to {highest}"),
        )),
        value => Ok(value.unwrap_or(default)),
    };
    let span =
        |key: &str, value: Option<units::Span>, default: Duration, lowest: Duration, highest: Duration| match value {
            Some(units::Span(value)) if value < lowest || value > highest => Err(refuse(
                key,
                format!(
                    "{} is out of range; allowed are {} to {}",
                    humantime::format_duration(value),
                    humantime::format_duration(lowest),
                    humantime::format_duration(highest)
                ),
            )),
            value => Ok(value.map_or(default, |s| s.0)),
        };
    let (second, hour) = (Duration::from_secs(1), Duration::from_secs(3600));
    let millisecond = Duration::from_millis(1);
    config.connections = count("connections", raw.connections, config.connections, 1_000_000)?;
    config.requests_per_connection = count(
        "requests_per_connection",
        raw.requests_per_connection,
        config.requests_per_connection,
        65_536,
    )?;
    config.header_timeout = span(
        "header_timeout",
        raw.header_timeout,
        config.header_timeout,
        10 * millisecond,
        hour,
    )?;
    config.keepalive_interval = span(
        "keepalive_interval",
        raw.keepalive_interval,
        config.keepalive_interval,
        second,
        hour,
    )?;
    config.keepalive_timeout = span(
        "keepalive_timeout",
        raw.keepalive_timeout,
        config.keepalive_timeout,
        second,
        hour,
    )?;
    config.drain_deadline = span(
        "drain_deadline",
        raw.drain_deadline,
        config.drain_deadline,
        10 * millisecond,
        hour,
    )?;
    if let Some(words) = &raw.cors_origins {
        config.origins = Origins::parse(&words.0).map_err(|problem| refuse("cors_origins", problem))?;
    }
    config.reflection = raw.reflection.unwrap_or(config.reflection);
    config.metrics = raw.metrics.unwrap_or(config.metrics);
    Ok(config)
}

fn session_config(raw: &raw::Raw, refuse: &impl Fn(&str, String) -> Error) -> Result<session::Config, Error> {
    let mut config = session::Config::default();
    let wide = |n: u64| usize::try_from(n).unwrap_or(usize::MAX);
    let set = |value: Option<units::ByteSize>, place: &mut u64| *place = value.map_or(*place, |size| size.0);
    set(raw.upload_bytes, &mut config.upload_bytes);
    set(raw.memory_bytes, &mut config.memory_bytes);
    set(raw.message_bytes, &mut config.message_bytes);
    config.vertices = raw.vertices.unwrap_or(config.vertices);
    // A closed surface has about twice as many triangles as vertices.
    config.triangles = raw
        .vertices
        .map_or(config.triangles, |vertices| vertices.saturating_mul(2).max(1024));
    config.sessions = raw.sessions.map_or(config.sessions, wide);
    config.handles = raw.handles.map_or(config.handles, |n| wide(n.into()));
    config.window = raw.window.unwrap_or(config.window);
    config.max_ttl = raw.max_ttl.map_or(config.max_ttl, |span| span.0);
    config.default_ttl = raw.ttl.map_or(config.default_ttl.min(config.max_ttl), |span| span.0);
    config.history = raw.history.map_or(config.history, |n| wide(n.into()));
    config.streams = raw.streams.map_or(config.streams, |n| wide(n.into()));
    config.compute_threads = raw.threads.map_or(config.compute_threads, |n| wide(n.into()));
    config.drain = raw.drain_deadline.map_or(config.drain, |span| span.0);
    if let Some(ms) = raw.solve_ms {
        if !(1.0..=3_600_000.0).contains(&ms) {
            return Err(refuse(
                "solve_ms",
                format!("{ms} is out of range; allowed are 1 to 3600000 milliseconds"),
            ));
        }
        config.solve = Duration::from_secs_f64(ms / 1e3);
    }
    if config.compute_threads > 1024 {
        return Err(refuse(
            "threads",
            format!(
                "{} is out of range; allowed are 1 to 1024, and 0 for one per core",
                config.compute_threads
            ),
        ));
    }
    if config.message_bytes > 256 << 20 {
        return Err(refuse(
            "message_bytes",
            format!("{} is out of range; allowed are 1KiB to 256MiB", config.message_bytes),
        ));
    }
    config.validate().map_err(|error| {
        let field = error.field.as_deref().unwrap_or_default();
        let key = match field {
            "defaultTtlMs" => "ttl".to_owned(),
            "maxTtlMs" => "max_ttl".to_owned(),
            "historyCommits" => "history".to_owned(),
            camel => snake(camel),
        };
        let problem = error
            .message
            .strip_prefix(field)
            .unwrap_or(&error.message)
            .trim_start_matches([':', ' ']);
        refuse(&key, problem.to_owned())
    })?;
    Ok(config)
}

fn snake(camel: &str) -> String {
    let mut text = String::new();
    for c in camel.chars() {
        if c.is_ascii_uppercase() {
            text.push('_');
        }
        text.push(c.to_ascii_lowercase());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    fn load(text: &str, flags: &[(&'static str, &str)]) -> Result<Settings, Error> {
        let file = file(text);
        let flags: Vec<_> = flags.iter().map(|(key, value)| (*key, (*value).to_owned())).collect();
        Settings::load(Some(file.path()), &flags)
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
        assert_eq!(settings.session.history, session::Config::default().history);
    }

    #[test]
    fn every_error_names_key_source_and_what_is_allowed() {
        type Case<'a> = (&'a str, &'a [(&'static str, &'a str)], &'a [&'a str]);
        let cases: [Case<'_>; 11] = [
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
                &["listen", "\"localhost\"", "127.0.0.1:7411", "--listen"],
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
        let error = Settings::load(Some(Path::new("/nowhere/pliant.toml")), &[]).unwrap_err();
        assert!(error.to_string().contains("/nowhere/pliant.toml"));
    }

    #[test]
    fn the_deployed_file_sets_every_key_to_its_default() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/config.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        // Keys stand there commented out, so that the file also works as it is.
        let active: String = text
            .lines()
            .map(|l| l.strip_prefix("#= ").unwrap_or(l))
            .fold(String::new(), |a, l| a + l + "\n");
        for key in KEYS {
            assert!(
                active.lines().any(|l| l.starts_with(&format!("{key} = "))),
                "{key} is not explained in deploy/config.toml"
            );
        }
        let told = load(&active, &[]).unwrap();
        let defaults = load("", &[]).unwrap();
        assert_eq!(
            (told.listen, &told.server, &told.session),
            (defaults.listen, &defaults.server, &defaults.session)
        );
        assert_eq!(
            (told.log, told.log_format, told.sample),
            (defaults.log, defaults.log_format, defaults.sample)
        );
    }
}
