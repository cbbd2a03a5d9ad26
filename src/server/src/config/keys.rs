//! The keys of the configuration, written down once for the command line, the file and the environment; the tables of the file; sizes
//! and times as people write them.

use pliant_session::TenantQuota;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

/// The keys of the configuration: each is a flag of the command line, a line of the file and an environment variable. A
/// key that is absent leaves the default.
#[derive(Debug, Clone, Default, clap::Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConfigKeys {
    /// Address and port [default: 127.0.0.1:7411]; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<KeyValue<String>>,
    /// Folder that stores sessions, so that they outlive the process [default: none, sessions are in memory only].
    #[arg(long, value_name = "FOLDER")]
    pub data_dir: Option<KeyValue<String>>,
    /// Database of the sessions, postgres://USER:PASSWORD@HOST/DATABASE [default: SQLite in the data folder].
    #[arg(long, value_name = "URL", hide_env_values = true)]
    pub database: Option<KeyValue<String>>,
    /// Object store of models and shapes, s3://BUCKET/PREFIX [default: the data folder].
    #[arg(long, value_name = "URL")]
    pub objects: Option<KeyValue<String>>,
    /// URL of this node for clients, if several nodes share database and objects [default: none, a single server].
    #[arg(long, value_name = "URL")]
    pub advertise: Option<KeyValue<String>>,
    /// Name of this node, for a proxy that routes by it [default: host and port of advertise].
    #[arg(long, value_name = "NAME")]
    pub node: Option<KeyValue<String>>,
    /// Lease on a node's sessions: how long it is valid without a renewal.
    #[arg(long, value_name = "TIME")]
    pub lease: Option<KeyValue<TimeSpan>>,
    /// Interval between renewals of the lease.
    #[arg(long, value_name = "TIME")]
    pub heartbeat: Option<KeyValue<TimeSpan>>,
    /// Compute threads [default: one per core].
    #[arg(long, value_name = "N")]
    pub threads: Option<KeyValue<u32>>,
    /// Maximum bytes of one upload, companions included.
    #[arg(long, value_name = "SIZE")]
    pub upload_bytes: Option<KeyValue<ByteSize>>,
    /// Maximum render vertices of one model.
    #[arg(long, value_name = "N")]
    pub vertices: Option<KeyValue<u64>>,
    /// Maximum open sessions.
    #[arg(long, value_name = "N")]
    pub sessions: Option<KeyValue<u64>>,
    /// Maximum memory of all sessions together.
    #[arg(long, value_name = "SIZE")]
    pub memory_bytes: Option<KeyValue<ByteSize>>,
    /// Maximum handles of one session.
    #[arg(long, value_name = "N")]
    pub handles: Option<KeyValue<u32>>,
    /// Maximum bytes of one control message.
    #[arg(long, value_name = "SIZE")]
    pub message_bytes: Option<KeyValue<ByteSize>>,
    /// Largest window of unacknowledged frames.
    #[arg(long, value_name = "N")]
    pub window: Option<KeyValue<u32>>,
    /// Time to live of an idle session that sets none.
    #[arg(long, value_name = "TIME")]
    pub ttl: Option<KeyValue<TimeSpan>>,
    /// Maximum time to live that a session may set.
    #[arg(long, value_name = "TIME")]
    pub max_ttl: Option<KeyValue<TimeSpan>>,
    /// How long an unused stored session stays in memory.
    #[arg(long, value_name = "TIME")]
    pub idle: Option<KeyValue<TimeSpan>>,
    /// Maximum commits that can be undone.
    #[arg(long, value_name = "N")]
    pub history: Option<KeyValue<u32>>,
    /// Maximum duration of a solve, in milliseconds.
    #[arg(long, value_name = "MS")]
    pub solve_ms: Option<KeyValue<f64>>,
    /// Maximum open streams of one session.
    #[arg(long, value_name = "N")]
    pub streams: Option<KeyValue<u32>>,
    /// Maximum animations at a time.
    #[arg(long, value_name = "N")]
    pub animations: Option<KeyValue<u32>>,
    /// Maximum bytes of one clip.
    #[arg(long, value_name = "SIZE")]
    pub clip_bytes: Option<KeyValue<ByteSize>>,
    /// Maximum joints of one clip.
    #[arg(long, value_name = "N")]
    pub clip_joints: Option<KeyValue<u32>>,
    /// Maximum frames of one animation.
    #[arg(long, value_name = "N")]
    pub animation_frames: Option<KeyValue<u32>>,
    /// Maximum requested frames of one animation times the vertices of its model.
    #[arg(long, value_name = "N")]
    pub animation_vertices: Option<KeyValue<u64>>,
    /// Time for open work to finish after a stop signal.
    #[arg(long, value_name = "TIME")]
    pub drain_deadline: Option<KeyValue<TimeSpan>>,
    /// Maximum open connections.
    #[arg(long, value_name = "N")]
    pub connections: Option<KeyValue<u32>>,
    /// Maximum open connections of one address.
    #[arg(long, value_name = "N")]
    pub connections_per_peer: Option<KeyValue<u32>>,
    /// Maximum HTTP/2 streams of one connection at a time.
    #[arg(long, value_name = "N")]
    pub requests_per_connection: Option<KeyValue<u32>>,
    /// Time for a connection to send the head of a request.
    #[arg(long, value_name = "TIME")]
    pub header_timeout: Option<KeyValue<TimeSpan>>,
    /// Idle time before a keep-alive ping.
    #[arg(long, value_name = "TIME")]
    pub keepalive_interval: Option<KeyValue<TimeSpan>>,
    /// Time for the answer to a keep-alive ping.
    #[arg(long, value_name = "TIME")]
    pub keepalive_timeout: Option<KeyValue<TimeSpan>>,
    /// Minimum upload rate, in bytes per second on average.
    #[arg(long, value_name = "SIZE")]
    pub upload_rate: Option<KeyValue<ByteSize>>,
    /// Maximum duration of an upload.
    #[arg(long, value_name = "TIME")]
    pub upload_deadline: Option<KeyValue<TimeSpan>>,
    /// How long an answer waits for the client to read more of it.
    #[arg(long, value_name = "TIME")]
    pub unread_deadline: Option<KeyValue<TimeSpan>>,
    /// Host names that clients may address the server by, separated by commas.
    #[arg(long, value_name = "HOSTS")]
    pub hosts: Option<KeyValue<WordList>>,
    /// Origins whose web pages may call the server, separated by commas.
    #[arg(long, value_name = "ORIGINS")]
    pub cors_origins: Option<KeyValue<WordList>>,
    /// File of the server's TLS certificate in PEM, followed by its issuers.
    #[arg(long, value_name = "FILE")]
    pub tls_certificate: Option<KeyValue<String>>,
    /// File of the certificate's private key in PEM.
    #[arg(long, value_name = "FILE")]
    pub tls_key: Option<KeyValue<String>>,
    /// File of the CA certificates in PEM that sign client certificates.
    #[arg(long, value_name = "FILE")]
    pub tls_client_ca: Option<KeyValue<String>>,
    /// Field of a client certificate that names its tenant: cn or uri.
    #[arg(long, value_name = "FIELD")]
    pub tls_client_tenant: Option<KeyValue<String>>,
    /// Serve every client that reaches the port, without authentication, from other machines too.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub insecure_open: Option<KeyValue<bool>>,
    /// Decode FBX and meshopt compression in a process that may do nothing else [default: true where the system can].
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub parse_apart: Option<KeyValue<bool>>,
    /// Log filter, such as info or info,pliant=debug.
    #[arg(long, value_name = "DIRECTIVES")]
    pub log: Option<KeyValue<String>>,
    /// Format of log lines: text or json.
    #[arg(long, value_name = "FORMAT")]
    pub log_format: Option<KeyValue<String>>,
    /// URL of an OTLP collector (gRPC) for traces, such as http://127.0.0.1:4317.
    #[arg(long, value_name = "URL")]
    pub otlp_endpoint: Option<KeyValue<String>>,
    /// Open a session with the built-in creature and print example calls.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub sample: Option<KeyValue<bool>>,
    /// Enable gRPC reflection.
    #[arg(long, value_name = "BOOL")]
    pub reflection: Option<KeyValue<bool>>,
    /// Enable /metrics.
    #[arg(long, value_name = "BOOL")]
    pub metrics: Option<KeyValue<bool>>,
    /// Who may call; a table of the file.
    #[arg(skip)]
    #[serde(skip_serializing)]
    pub auth: Option<AuthTable>,
    /// What each tenant may use that is not named below; a table of the file.
    #[arg(skip)]
    #[serde(skip_serializing)]
    pub quotas: Option<QuotaTable>,
    /// What those may use that are named; a table of the file for each.
    #[arg(skip)]
    #[serde(skip_serializing)]
    pub tenants: Option<BTreeMap<String, QuotaTable>>,
}

impl ConfigKeys {
    /// Names every key, in the order in which `deploy/config.toml` explains them.
    pub fn names() -> Vec<String> {
        let command = <Self as clap::Args>::augment_args(clap::Command::new("pliant"));
        command.get_arguments().map(|key| key.get_id().to_string()).collect()
    }
}

/// The value of a key. Flags are texts at first; they are merged with file and environment, and all are read by the same
/// rules then.
#[derive(Debug, Clone, PartialEq)]
pub enum KeyValue<T> {
    /// A flag's text, not read yet.
    Text(String),
    /// What the winning source says.
    Read(T),
}

impl<T> KeyValue<T> {
    /// The value of a key after all sources were merged; `None` leaves the default.
    pub(super) fn read(value: &Option<Self>) -> Option<T>
    where
        T: Clone,
    {
        match value {
            Some(Self::Read(value)) => Some(value.clone()),
            Some(Self::Text(_)) | None => None,
        }
    }
}

impl<T> From<String> for KeyValue<T> {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl<T> Serialize for KeyValue<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Text(text) => serializer.serialize_str(text),
            Self::Read(_) => serializer.serialize_none(),
        }
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for KeyValue<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        T::deserialize(deserializer).map(Self::Read)
    }
}

/// The table `auth` lists who may call. Only the file can contain it, neither flags nor the environment.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuthTable {
    /// Accepted tokens.
    #[serde(default)]
    pub(super) tokens: Vec<TokenTable>,
    /// The issuer whose tokens are accepted.
    pub(super) jwt: Option<JwtTable>,
}

/// One token, as in the file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenTable {
    pub(super) tenant: String,
    pub(super) sha256: String,
    pub(super) name: Option<String>,
    pub(super) expires: Option<String>,
    #[serde(default)]
    pub(super) metrics: bool,
}

/// The issuer whose tokens are accepted, as in the file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JwtTable {
    pub(super) jwks: String,
    pub(super) ca: Option<String>,
    pub(super) issuer: String,
    pub(super) audience: WordList,
    pub(super) algorithms: Option<WordList>,
    pub(super) tenant_claim: Option<String>,
    pub(super) leeway: Option<TimeSpan>,
    pub(super) refresh: Option<TimeSpan>,
}

/// What a tenant may use, as in the file.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuotaTable {
    sessions: Option<u64>,
    memory_bytes: Option<ByteSize>,
    stored_bytes: Option<ByteSize>,
    upload_bytes_per_minute: Option<ByteSize>,
    solve_seconds_per_minute: Option<f64>,
    streams: Option<u64>,
    ttl: Option<TimeSpan>,
    max_ttl: Option<TimeSpan>,
    audit_age: Option<TimeSpan>,
}

impl From<QuotaTable> for TenantQuota {
    fn from(table: QuotaTable) -> Self {
        let bytes = |size: Option<ByteSize>| size.map(|size| size.0);
        let span = |span: Option<TimeSpan>| span.map(|span| span.0);
        Self {
            sessions: table.sessions,
            memory_bytes: bytes(table.memory_bytes),
            stored_bytes: bytes(table.stored_bytes),
            upload_bytes_per_minute: bytes(table.upload_bytes_per_minute),
            solve_seconds_per_minute: table.solve_seconds_per_minute,
            streams: table.streams,
            ttl: span(table.ttl),
            max_ttl: span(table.max_ttl),
            audit_age: span(table.audit_age),
        }
    }
}

/// A number of bytes: `1048576`, `"512MiB"`, `"2 GB"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ByteSize(pub u64);

/// A span of time with a unit: `"15m"`, `"1h 30m"`, `"250ms"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimeSpan(pub Duration);

/// A list of texts, or one text with commas.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WordList(pub Vec<String>);

const UNITS: [(&str, u64); 9] = [
    ("", 1),
    ("B", 1),
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
    ("TiB", 1 << 40),
    ("KB", 1_000),
    ("MB", 1_000_000),
    ("GB", 1_000_000_000),
];

/// Reads a number of bytes; the problem does not name the key.
fn parse_byte_size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = (&text[..digits], text[digits..].trim());
    let refuse =
        || format!("\"{text}\" is not a size; allowed are bytes or a whole number with KiB, MiB, GiB, KB, MB or GB");
    let number: u64 = number.parse().map_err(|_| refuse())?;
    let (_, factor) = UNITS
        .into_iter()
        .find(|(name, _)| name.eq_ignore_ascii_case(unit))
        .ok_or_else(refuse)?;
    number
        .checked_mul(factor)
        .ok_or_else(|| format!("\"{text}\" is more than 2^64 bytes"))
}

/// Reads a span of time; the problem does not name the key.
fn parse_time_span(text: &str) -> Result<Duration, String> {
    humantime::parse_duration(text).map_err(|_| {
        format!("\"{text}\" is not a span of time; allowed are numbers with units, such as 250ms, 10s or 1h 30m")
    })
}

impl<'de> Deserialize<'de> for ByteSize {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ByteSizeVisitor;
        impl de::Visitor<'_> for ByteSizeVisitor {
            type Value = ByteSize;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a size such as 1048576 or \"512MiB\"")
            }

            fn visit_u64<E: de::Error>(self, value: u64) -> Result<ByteSize, E> {
                Ok(ByteSize(value))
            }

            fn visit_i64<E: de::Error>(self, value: i64) -> Result<ByteSize, E> {
                u64::try_from(value)
                    .map(ByteSize)
                    .map_err(|_| E::invalid_value(de::Unexpected::Signed(value), &self))
            }

            fn visit_str<E: de::Error>(self, value: &str) -> Result<ByteSize, E> {
                parse_byte_size(value).map(ByteSize).map_err(E::custom)
            }
        }
        deserializer.deserialize_any(ByteSizeVisitor)
    }
}

impl<'de> Deserialize<'de> for TimeSpan {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TimeSpanVisitor;
        impl de::Visitor<'_> for TimeSpanVisitor {
            type Value = TimeSpan;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a span of time with a unit, such as \"250ms\", \"10s\" or \"1h 30m\"")
            }

            fn visit_str<E: de::Error>(self, value: &str) -> Result<TimeSpan, E> {
                parse_time_span(value).map(TimeSpan).map_err(E::custom)
            }
        }
        deserializer.deserialize_any(TimeSpanVisitor)
    }
}

impl<'de> Deserialize<'de> for WordList {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct WordListVisitor;
        impl<'de> de::Visitor<'de> for WordListVisitor {
            type Value = WordList;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of texts, or one text with commas")
            }

            fn visit_str<E: de::Error>(self, value: &str) -> Result<WordList, E> {
                Ok(WordList(
                    value
                        .split(',')
                        .map(str::trim)
                        .filter(|w| !w.is_empty())
                        .map(str::to_owned)
                        .collect(),
                ))
            }

            fn visit_seq<A: de::SeqAccess<'de>>(self, mut seq: A) -> Result<WordList, A::Error> {
                let mut words = Vec::new();
                while let Some(word) = seq.next_element::<String>()? {
                    words.push(word);
                }
                Ok(WordList(words))
            }
        }
        deserializer.deserialize_any(WordListVisitor)
    }
}

#[cfg(test)]
mod units_tests {
    use super::*;

    #[test]
    fn sizes_take_binary_and_decimal_units() {
        assert_eq!(parse_byte_size("512MiB"), Ok(512 << 20));
        assert_eq!(parse_byte_size(" 2 gb "), Ok(2_000_000_000));
        assert_eq!(parse_byte_size("17"), Ok(17));
    }

    #[test]
    fn a_wrong_size_says_what_is_allowed() {
        for text in ["", "MiB", "1.5MiB", "-1", "12 parsecs", "99999999999999999999"] {
            let problem = parse_byte_size(text).unwrap_err();
            assert!(problem.contains("allowed are") && problem.contains(text), "{problem}");
        }
        assert!(parse_byte_size("99999999999TiB").unwrap_err().contains("2^64"));
    }

    #[test]
    fn a_time_without_unit_is_refused() {
        assert_eq!(parse_time_span("1h 30m"), Ok(Duration::from_secs(5400)));
        assert!(parse_time_span("15").unwrap_err().contains("allowed are"));
    }
}
