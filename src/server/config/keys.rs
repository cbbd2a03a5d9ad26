//! The keys of the configuration, written down once: for the command line, the file and the environment.

use super::auth_table::AuthTable;
use super::quota_table::QuotaTable;
use super::units::{ByteSize, TimeSpan, WordList};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;

/// The keys of the configuration: each is a flag of the command line, a line of the file and an environment variable. A
/// key that is absent leaves the default.
#[derive(Debug, Clone, Default, clap::Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConfigKeys {
    /// Address and port [default: 127.0.0.1:7411]; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<KeyValue<String>>,
    /// Folder where sessions are kept, so that they outlive the process [default: none, sessions are in memory alone].
    #[arg(long, value_name = "FOLDER")]
    pub data_dir: Option<KeyValue<String>>,
    /// Database of the sessions, postgres://USER:PASSWORD@HOST/DATABASE [default: SQLite in the data folder].
    #[arg(long, value_name = "URL", hide_env_values = true)]
    pub database: Option<KeyValue<String>>,
    /// Place of models and shapes, s3://BUCKET/PREFIX [default: the data folder].
    #[arg(long, value_name = "URL")]
    pub objects: Option<KeyValue<String>>,
    /// Address under which clients reach this node of several that share database and objects [default: none, one server has them].
    #[arg(long, value_name = "URL")]
    pub advertise: Option<KeyValue<String>>,
    /// Name of this node, by which a proxy tells nodes apart [default: host and port of advertise].
    #[arg(long, value_name = "NAME")]
    pub node: Option<KeyValue<String>>,
    /// How long a node keeps its sessions without a word to the database.
    #[arg(long, value_name = "TIME")]
    pub lease: Option<KeyValue<TimeSpan>>,
    /// How often it says one.
    #[arg(long, value_name = "TIME")]
    pub heartbeat: Option<KeyValue<TimeSpan>>,
    /// Compute threads [default: one per core].
    #[arg(long, value_name = "N")]
    pub threads: Option<KeyValue<u32>>,
    /// Bytes of one upload, companions included.
    #[arg(long, value_name = "SIZE")]
    pub upload_bytes: Option<KeyValue<ByteSize>>,
    /// Render vertices of one model.
    #[arg(long, value_name = "N")]
    pub vertices: Option<KeyValue<u64>>,
    /// Sessions held at a time.
    #[arg(long, value_name = "N")]
    pub sessions: Option<KeyValue<u64>>,
    /// Bytes that all sessions together may hold.
    #[arg(long, value_name = "SIZE")]
    pub memory_bytes: Option<KeyValue<ByteSize>>,
    /// Handles of one session.
    #[arg(long, value_name = "N")]
    pub handles: Option<KeyValue<u32>>,
    /// Bytes of one control message.
    #[arg(long, value_name = "SIZE")]
    pub message_bytes: Option<KeyValue<ByteSize>>,
    /// Largest window of unacknowledged frames.
    #[arg(long, value_name = "N")]
    pub window: Option<KeyValue<u32>>,
    /// How long an idle session lives when it names no time.
    #[arg(long, value_name = "TIME")]
    pub ttl: Option<KeyValue<TimeSpan>>,
    /// Longest time that a session may ask for.
    #[arg(long, value_name = "TIME")]
    pub max_ttl: Option<KeyValue<TimeSpan>>,
    /// How long a kept session that nobody uses stays in memory.
    #[arg(long, value_name = "TIME")]
    pub idle: Option<KeyValue<TimeSpan>>,
    /// Commits that can be undone.
    #[arg(long, value_name = "N")]
    pub history: Option<KeyValue<u32>>,
    /// Longest solve, in milliseconds.
    #[arg(long, value_name = "MS")]
    pub solve_ms: Option<KeyValue<f64>>,
    /// Streams open on one session at a time.
    #[arg(long, value_name = "N")]
    pub streams: Option<KeyValue<u32>>,
    /// Animations under way at a time.
    #[arg(long, value_name = "N")]
    pub animations: Option<KeyValue<u32>>,
    /// Bytes of one clip.
    #[arg(long, value_name = "SIZE")]
    pub clip_bytes: Option<KeyValue<ByteSize>>,
    /// Joints of one clip.
    #[arg(long, value_name = "N")]
    pub clip_joints: Option<KeyValue<u32>>,
    /// Frames of one animation.
    #[arg(long, value_name = "N")]
    pub animation_frames: Option<KeyValue<u32>>,
    /// Frames that are wanted of one animation, times the vertices of its model.
    #[arg(long, value_name = "N")]
    pub animation_vertices: Option<KeyValue<u64>>,
    /// How long open work may go on once the server is asked to stop.
    #[arg(long, value_name = "TIME")]
    pub drain_deadline: Option<KeyValue<TimeSpan>>,
    /// Connections held at a time.
    #[arg(long, value_name = "N")]
    pub connections: Option<KeyValue<u32>>,
    /// Connections of one address at a time.
    #[arg(long, value_name = "N")]
    pub connections_per_peer: Option<KeyValue<u32>>,
    /// HTTP/2 streams of one connection at a time.
    #[arg(long, value_name = "N")]
    pub requests_per_connection: Option<KeyValue<u32>>,
    /// How long a connection may take to send the head of a request.
    #[arg(long, value_name = "TIME")]
    pub header_timeout: Option<KeyValue<TimeSpan>>,
    /// Silence after which a peer is asked for a sign of life.
    #[arg(long, value_name = "TIME")]
    pub keepalive_interval: Option<KeyValue<TimeSpan>>,
    /// How long that sign of life may take.
    #[arg(long, value_name = "TIME")]
    pub keepalive_timeout: Option<KeyValue<TimeSpan>>,
    /// Slowest upload, in bytes a second on average.
    #[arg(long, value_name = "SIZE")]
    pub upload_rate: Option<KeyValue<ByteSize>>,
    /// Longest time that an upload may take.
    #[arg(long, value_name = "TIME")]
    pub upload_deadline: Option<KeyValue<TimeSpan>>,
    /// How long an answer may wait for its reader to take some more of it.
    #[arg(long, value_name = "TIME")]
    pub unread_deadline: Option<KeyValue<TimeSpan>>,
    /// Names under which the server may be addressed, with commas between them.
    #[arg(long, value_name = "HOSTS")]
    pub hosts: Option<KeyValue<WordList>>,
    /// Origins whose pages may call, with commas between them.
    #[arg(long, value_name = "ORIGINS")]
    pub cors_origins: Option<KeyValue<WordList>>,
    /// File of the server's TLS certificate, in PEM, those that signed it after it.
    #[arg(long, value_name = "FILE")]
    pub tls_certificate: Option<KeyValue<String>>,
    /// File of its private key, in PEM.
    #[arg(long, value_name = "FILE")]
    pub tls_key: Option<KeyValue<String>>,
    /// File of the authorities whose certificates clients may show, in PEM.
    #[arg(long, value_name = "FILE")]
    pub tls_client_ca: Option<KeyValue<String>>,
    /// What of a client's certificate is its tenant: cn or uri.
    #[arg(long, value_name = "FIELD")]
    pub tls_client_tenant: Option<KeyValue<String>>,
    /// Serve whoever reaches the port, also where that is not this machine alone.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub insecure_open: Option<KeyValue<bool>>,
    /// Which log lines are written, such as info or info,pliant=debug.
    #[arg(long, value_name = "DIRECTIVES")]
    pub log: Option<KeyValue<String>>,
    /// How log lines look: text or json.
    #[arg(long, value_name = "FORMAT")]
    pub log_format: Option<KeyValue<String>>,
    /// Collector that spans are sent to by OTLP over gRPC, such as http://127.0.0.1:4317.
    #[arg(long, value_name = "URL")]
    pub otlp_endpoint: Option<KeyValue<String>>,
    /// Open a session with the built-in creature and print calls to try.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub sample: Option<KeyValue<bool>>,
    /// Whether gRPC reflection answers.
    #[arg(long, value_name = "BOOL")]
    pub reflection: Option<KeyValue<bool>>,
    /// Whether /metrics answers.
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
    /// A flag's text, which nobody has read yet.
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
