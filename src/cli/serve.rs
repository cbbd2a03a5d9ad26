//! `pliant serve`: the server as a program.

use super::failure::CliFailure;
use crate::asset::FileSet;
use crate::job::pb;
use crate::server::config::{self, Settings};
use crate::server::{self, sample};
use crate::session::{self, Manager, Tenant};
use std::io::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Instant;
use tokio::net::TcpListener;

/// Serves gRPC, gRPC-Web, HTTP and WebSocket on one port.
///
/// Every key of the configuration is also an environment variable (PLIANT_ and the key in capitals) and a flag; flags win
/// over the environment, the environment over the file.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ServeArgs {
    /// Configuration file (TOML); deploy/config.toml explains every key.
    #[arg(long, value_name = "FILE", env = "PLIANT_CONFIG")]
    pub config: Option<PathBuf>,
    /// Keys of the configuration.
    #[command(flatten)]
    pub keys: Box<Keys>,
}

/// The keys of the configuration as flags; texts, read by the same rules as those of the file.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Keys {
    /// Address and port [default: 127.0.0.1:7411]; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<String>,
    /// Compute threads [default: one per core].
    #[arg(long, value_name = "N")]
    pub threads: Option<String>,
    /// Bytes of one upload, companions included.
    #[arg(long, value_name = "SIZE")]
    pub upload_bytes: Option<String>,
    /// Render vertices of one model.
    #[arg(long, value_name = "N")]
    pub vertices: Option<String>,
    /// Sessions held at a time.
    #[arg(long, value_name = "N")]
    pub sessions: Option<String>,
    /// Bytes that all sessions together may hold.
    #[arg(long, value_name = "SIZE")]
    pub memory_bytes: Option<String>,
    /// Handles of one session.
    #[arg(long, value_name = "N")]
    pub handles: Option<String>,
    /// Bytes of one control message.
    #[arg(long, value_name = "SIZE")]
    pub message_bytes: Option<String>,
    /// Largest window of unacknowledged frames.
    #[arg(long, value_name = "N")]
    pub window: Option<String>,
    /// How long an idle session lives when it names no time.
    #[arg(long, value_name = "TIME")]
    pub ttl: Option<String>,
    /// Longest time that a session may ask for.
    #[arg(long, value_name = "TIME")]
    pub max_ttl: Option<String>,
    /// Commits that can be undone.
    #[arg(long, value_name = "N")]
    pub history: Option<String>,
    /// Longest solve, in milliseconds.
    #[arg(long, value_name = "MS")]
    pub solve_ms: Option<String>,
    /// Streams open on one session at a time.
    #[arg(long, value_name = "N")]
    pub streams: Option<String>,
    /// How long open work may go on once the server is asked to stop.
    #[arg(long, value_name = "TIME")]
    pub drain_deadline: Option<String>,
    /// Connections held at a time.
    #[arg(long, value_name = "N")]
    pub connections: Option<String>,
    /// HTTP/2 streams of one connection at a time.
    #[arg(long, value_name = "N")]
    pub requests_per_connection: Option<String>,
    /// How long a connection may take to send the head of a request.
    #[arg(long, value_name = "TIME")]
    pub header_timeout: Option<String>,
    /// Silence after which a peer is asked for a sign of life.
    #[arg(long, value_name = "TIME")]
    pub keepalive_interval: Option<String>,
    /// How long that sign of life may take.
    #[arg(long, value_name = "TIME")]
    pub keepalive_timeout: Option<String>,
    /// Origins whose pages may call, with commas between them.
    #[arg(long, value_name = "ORIGINS")]
    pub cors_origins: Option<String>,
    /// Which log lines are written, such as info or info,pliant=debug.
    #[arg(long, value_name = "DIRECTIVES")]
    pub log: Option<String>,
    /// How log lines look: text or json.
    #[arg(long, value_name = "FORMAT")]
    pub log_format: Option<String>,
    /// Open a session with the built-in creature and print calls to try.
    #[arg(long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub sample: Option<String>,
    /// Whether gRPC reflection answers.
    #[arg(long, value_name = "BOOL")]
    pub reflection: Option<String>,
    /// Whether /metrics answers.
    #[arg(long, value_name = "BOOL")]
    pub metrics: Option<String>,
}

/// Why the server did not run.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The configuration cannot be used.
    #[error("configuration: {0}")]
    Config(#[from] config::Error),
    /// The port cannot be had.
    #[error("cannot listen on {address}: {problem}")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// What the operating system said.
        problem: String,
    },
    /// Signals cannot be awaited.
    #[error("cannot wait for signals: {0}")]
    Signals(String),
    /// The sessions cannot be held.
    #[error("{0}")]
    Session(#[from] session::Error),
    /// The services cannot start.
    #[error(transparent)]
    Server(#[from] server::Error),
}

impl ServeError {
    /// Whether the user can mend it: exit code 2, else 3.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Config(_) | Self::Listen { .. } | Self::Session(_))
    }
}

impl Keys {
    /// The flags that were given, as (key, text).
    fn flags(&self) -> Vec<(&'static str, String)> {
        let all: [(&'static str, &Option<String>); 26] = [
            ("listen", &self.listen),
            ("threads", &self.threads),
            ("upload_bytes", &self.upload_bytes),
            ("vertices", &self.vertices),
            ("sessions", &self.sessions),
            ("memory_bytes", &self.memory_bytes),
            ("handles", &self.handles),
            ("message_bytes", &self.message_bytes),
            ("window", &self.window),
            ("ttl", &self.ttl),
            ("max_ttl", &self.max_ttl),
            ("history", &self.history),
            ("solve_ms", &self.solve_ms),
            ("streams", &self.streams),
            ("drain_deadline", &self.drain_deadline),
            ("connections", &self.connections),
            ("requests_per_connection", &self.requests_per_connection),
            ("header_timeout", &self.header_timeout),
            ("keepalive_interval", &self.keepalive_interval),
            ("keepalive_timeout", &self.keepalive_timeout),
            ("cors_origins", &self.cors_origins),
            ("log", &self.log),
            ("log_format", &self.log_format),
            ("sample", &self.sample),
            ("reflection", &self.reflection),
            ("metrics", &self.metrics),
        ];
        all.into_iter()
            .filter_map(|(key, value)| Some((key, value.clone()?)))
            .collect()
    }
}

/// Runs the server of this process.
pub(super) fn run_serve(args: ServeArgs) -> Result<(), CliFailure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .thread_name("pliant-serve")
        .build();
    let runtime = runtime.map_err(|e| CliFailure::Internal(format!("cannot start threads: {e}")))?;
    let done = runtime.block_on(run(args)).map_err(|error| {
        if error.is_usage() {
            CliFailure::Input(error.to_string())
        } else {
            CliFailure::Internal(error.to_string())
        }
    });
    // Work that ignored the deadline ends with the process; waiting for its threads would undo the deadline.
    runtime.shutdown_background();
    done
}

/// Reads the configuration, serves until SIGTERM or SIGINT, drains and returns.
///
/// Prints one line on stdout once it listens: `listening on http://ADDRESS:PORT`.
///
/// # Errors
/// When the configuration, the port or the services cannot be had. A drain that met its deadline is no error.
pub async fn run(args: ServeArgs) -> Result<(), ServeError> {
    let settings = Settings::load(args.config.as_deref(), &args.keys.flags())?;
    server::start_log(&settings.log, settings.log_format);
    for remark in &settings.remarks {
        tracing::warn!("{remark}");
    }
    let mut signals = Signals::new().map_err(|e| ServeError::Signals(e.to_string()))?;
    let refuse = |e: std::io::Error| ServeError::Listen {
        address: settings.listen,
        problem: e.to_string(),
    };
    let listener = TcpListener::bind(settings.listen).await.map_err(refuse)?;
    let address = listener.local_addr().map_err(refuse)?;
    let manager = Manager::new(settings.session)?;
    let limits = manager.limits();
    tracing::info!(
        server.version = env!("CARGO_PKG_VERSION"),
        server.address = %address,
        limits.sessions = limits.sessions,
        limits.memory_bytes = limits.memory_bytes,
        limits.upload_bytes = limits.upload_bytes,
        "listening on http://{address}"
    );
    if settings.sample {
        let (manager, shown) = (manager.clone(), address);
        tokio::spawn(async move {
            if let Err(error) = open_sample(&manager, shown).await {
                tracing::warn!("the sample session cannot be opened: {error}");
            }
        });
    }
    // Whoever started this process may wait for the line; that nobody reads it is no reason to stop.
    let mut out = std::io::stdout();
    let _ = writeln!(out, "listening on http://{address}").and_then(|()| out.flush());
    let hurried = manager.clone();
    let shutdown = async move {
        signals.next().await;
        tokio::spawn(async move {
            signals.next().await;
            tracing::warn!("asked again: giving up what still runs");
            hurried.abort();
        });
    };
    server::run(listener, manager, settings.server, shutdown).await?;
    Ok(())
}

/// The wishes to stop: SIGTERM and SIGINT.
struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
}

impl Signals {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
        })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}

/// Opens a session with the built-in creature, turns its head once, and says how to go on.
async fn open_sample(manager: &Manager, address: SocketAddr) -> Result<(), session::Error> {
    let tenant = Tenant::default();
    let started = Instant::now();
    let files = FileSet::single(format!("{}.glb", sample::NAME), sample::glb().await?);
    // It stands ready for a person, who may take a while.
    let ttl = humantime::format_duration(manager.config().max_ttl).to_string();
    let options = pb::CreateOptions {
        label: sample::NAME.into(),
        ttl,
        ..pb::CreateOptions::default()
    };
    let session = manager.create(&tenant, files, options, None).await?.value;
    let id = session.id;
    let request = pb::SetHandlesRequest {
        session_id: id.clone(),
        handles: sample::handles(),
        ..pb::SetHandlesRequest::default()
    };
    manager.set_handles(&tenant, request, None).await?;
    let pose = pb::HandlePose {
        rotation_vector: vec![0.0, 0.8, 0.0],
        ..pb::HandlePose::default()
    };
    let pose = pb::Pose {
        handles: vec![pb::pose::Entry {
            id: "head".into(),
            pose: Some(pose),
        }],
        ..pb::Pose::default()
    };
    let solve = pb::SolveRequest {
        session_id: id.clone(),
        pose: Some(pose),
        options: None,
    };
    let solved = manager.solve(&tenant, solve, None).await?;
    let frame = solved.frames.first();
    tracing::info!(
        session.id = %id,
        mesh.vertices = solved.positions.len(),
        solve.residual = frame.map_or(0.0, |f| f.residual),
        solve.duration_ms = frame.map_or(0.0, |f| f.solve_ms),
        duration_ms = started.elapsed().as_millis() as u64,
        "opened the sample session `{id}`, held its feet and turned its head"
    );
    let base = format!("http://{address}/v1/sessions/{id}");
    let body = r#"{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, -0.8, 0.4]}}]}}"#;
    let text = format!(
        "\nA creature stands ready, its feet held and its head movable. Try:\n\n  \
         curl -s {base}\n  \
         curl -s {base}/solve -H 'content-type: application/json' -H 'accept: model/gltf-binary' -o turned.glb \\\n    \
         -d '{body}'\n  \
         curl -s -X POST {base}/undo\n  \
         curl -s '{base}/model?format=obj' -o creature.obj\n\n"
    );
    let _ = std::io::stderr().write_all(text.as_bytes());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args as _, FromArgMatches as _};

    fn parse(words: &[&str]) -> ServeArgs {
        let command = ServeArgs::augment_args(clap::Command::new("serve"));
        let matches = command
            .try_get_matches_from(std::iter::once("serve").chain(words.iter().copied()))
            .unwrap();
        ServeArgs::from_arg_matches(&matches).unwrap()
    }

    #[test]
    fn every_key_is_a_flag() {
        for key in config::KEYS {
            let flag = format!("--{}=1", key.replace('_', "-"));
            assert_eq!(parse(&[&flag]).keys.flags(), vec![(key, "1".to_owned())], "{key}");
        }
    }

    #[test]
    fn sample_needs_no_value() {
        assert_eq!(parse(&["--sample"]).keys.flags(), vec![("sample", "true".to_owned())]);
    }
}
