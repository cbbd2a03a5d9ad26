//! `pliant serve`: the server as a program.

use super::parser_process;
use super::terminal::{CliFailure, StopSignals};
use crate::asset::sample::{BuiltInModel, HANDLES};
use crate::asset::{FileSet, ParserStarter};
use crate::engine::{Handle, HandlePose, HandleSet, Region};
use crate::server;
use crate::server::config::{ConfigKeys, LogFormat, ServeSettings};
use crate::session::store::{Store, StoreError};
use crate::session::{self, Manager, OpenDeformer, Tenant};
use crate::wire::{DeformOptions, PoseCommit, SessionOptions};
use std::io::{IsTerminal as _, Write as _};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
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
    pub keys: Box<ConfigKeys>,
}

/// Why the server did not run.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The configuration cannot be used.
    #[error("configuration: {0}")]
    Config(server::Error),
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
    /// Spans cannot be sent.
    #[error("otlp_endpoint: {0}")]
    Traces(String),
    /// Files cannot be decoded apart, and the configuration demands it.
    #[error(
        "parse_apart: {0}; with --parse-apart=false FBX and meshopt compression are decoded in the server's own process"
    )]
    ParseApart(String),
    /// The sessions cannot be held.
    #[error("{0}")]
    Session(#[from] session::Error),
    /// The store of sessions cannot be had.
    #[error("the store of sessions: {0}")]
    Store(#[from] StoreError),
    /// The services cannot start.
    #[error(transparent)]
    Server(#[from] server::Error),
}

impl ServeError {
    /// Whether the user can mend it: exit code 2, else 3.
    pub fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Config(_)
                | Self::Listen { .. }
                | Self::ParseApart(_)
                | Self::Session(_)
                | Self::Store(_)
                | Self::Traces(_)
        )
    }
}

/// Runs the server of this process.
pub(super) fn run_serve(args: ServeArgs) -> Result<(), CliFailure> {
    server::use_one_heap();
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
    let done = done.map_err(|failure| match server::logs_json() {
        true => {
            tracing::error!("{}", failure.message());
            CliFailure::Logged(failure.exit_code())
        }
        false => failure,
    });
    // Work that ignored the deadline ends with the process; waiting for its threads would undo the deadline.
    runtime.shutdown_background();
    done
}

/// Reads the configuration, serves until SIGTERM or SIGINT, drains and returns.
///
/// Prints one line on stdout once it listens: `listening on http://ADDRESS:PORT`, or `https` where it speaks TLS; where the log is
/// JSON, a line of its form with these words as the message.
///
/// # Errors
/// When the configuration, the port or the services fail. A drain that reaches its deadline is not an error.
pub async fn run(args: ServeArgs) -> Result<(), ServeError> {
    let settings = ServeSettings::load(args.config.as_deref(), &args.keys).map_err(ServeError::Config)?;
    let endpoint = settings.otlp_endpoint.as_deref();
    let traces = server::start_log(&settings.log, settings.log_format, endpoint).map_err(ServeError::Traces)?;
    for remark in &settings.remarks {
        tracing::warn!("{remark}");
    }
    let mut session = settings.session;
    session.apart = parsers_apart(settings.parse_apart, session.build)?;
    let mut signals = StopSignals::new().map_err(|e| ServeError::Signals(e.to_string()))?;
    let refuse = |e: std::io::Error| ServeError::Listen {
        address: settings.listen,
        problem: e.to_string(),
    };
    let listener = TcpListener::bind(settings.listen).await.map_err(refuse)?;
    let address = listener.local_addr().map_err(refuse)?;
    let (manager, store) = match &settings.store {
        Some(location) => {
            let store = Arc::new(Store::open(&location.on_port(address.port())).await?);
            let manager = Manager::with_store(session, OpenDeformer, Arc::clone(&store)).await?;
            tracing::info!("sessions are kept in {location}");
            (manager, Some(store))
        }
        None => {
            tracing::info!("sessions are in memory only and end with this process; --data-dir stores them");
            (Manager::new(session)?, None)
        }
    };
    let limits = manager.config();
    let scheme = if settings.server.tls.is_some() { "https" } else { "http" };
    let url = format!("{scheme}://{address}");
    tracing::info!(
        server.version = env!("CARGO_PKG_VERSION"),
        server.address = %address,
        limits.sessions = limits.sessions,
        limits.memory_bytes = limits.memory_bytes,
        limits.upload_bytes = limits.upload_bytes,
        "serving on {url}"
    );
    if settings.sample {
        let (manager, url, format) = (manager.clone(), url.clone(), settings.log_format);
        tokio::spawn(async move {
            match open_sample(&manager).await {
                Ok(id) => print_sample_address(&url, &id, format),
                Err(error) => tracing::warn!("the sample session cannot be opened: {error}"),
            }
        });
    }
    print_listening(&url, settings.log_format);
    let hurried = manager.clone();
    let shutdown = async move {
        signals.next().await;
        tokio::spawn(async move {
            signals.next().await;
            tracing::warn!("second signal: aborting all running work");
            hurried.abort();
        });
    };
    let served = server::run(listener, manager, settings.server, shutdown).await;
    if let Some(store) = store {
        store.close().await;
    }
    traces.finish().await;
    Ok(served?)
}

/// What starts the processes that decode files, each of them for at most `longest`, once one of them has started; `None` where the
/// configuration wants none, or says nothing and none can be had.
fn parsers_apart(wanted: Option<bool>, longest: Duration) -> Result<Option<ParserStarter>, ServeError> {
    if wanted == Some(false) {
        return Ok(None);
    }
    let start = parser_process::start;
    match (start(longest), wanted) {
        (Ok(_), _) => Ok(Some(ParserStarter { start, longest })),
        (Err(problem), Some(_)) => Err(ServeError::ParseApart(problem.to_string())),
        (Err(problem), None) => {
            tracing::warn!("FBX and meshopt compression are decoded in this process: {problem}");
            Ok(None)
        }
    }
}

/// Opens a session with the built-in creature and turns its head once; answers its id.
async fn open_sample(manager: &Manager) -> Result<String, session::Error> {
    let tenant = Tenant::default();
    let started = Instant::now();
    let shown = BuiltInModel::Creature;
    let files = FileSet::single(format!("{}.glb", shown.name()), shown.glb());
    let options = SessionOptions {
        label: shown.name().into(),
        // It stands ready for a person, who may take a while.
        ttl: Some(manager.config().max_ttl),
        ..SessionOptions::default()
    };
    let session = manager.create(&tenant, files, options, None).await?.value;
    let id = session.id;
    let ((normal, offset), (center, radius)) = (HANDLES.feet, HANDLES.head);
    let handles = HandleSet::from([
        Handle::new("feet", Region::half_space(normal, offset)),
        Handle::new("head", Region::sphere(center, radius)),
    ]);
    manager.set_handles(&tenant, &id, handles, None).await?;
    let turned = PoseCommit {
        seq: 0,
        changes: vec![("head".into(), HandlePose::rotation([0.0, 0.8, 0.0]))],
        options: DeformOptions::with_defaults(manager.config().window),
    };
    let solved = manager.solve(&tenant, &id, turned, None).await?;
    let frame = &solved.frame;
    tracing::info!(
        session.id = %id,
        mesh.vertices = frame.positions.len(),
        solve.residual = frame.header.residual,
        solve.duration_ms = frame.header.solve_ms,
        duration_ms = started.elapsed().as_millis() as u64,
        "opened the sample session `{id}`: its feet are fixed, its head is turned"
    );
    Ok(id)
}

/// Writes to stdout where the server listens; a parent process may wait for this line. A write error does not stop the
/// server.
pub(super) fn print_listening(url: &str, format: LogFormat) {
    let words = format!("listening on {url}");
    let line = match format {
        LogFormat::Text => words,
        LogFormat::Json => serde_json::json!({
            "timestamp": humantime::format_rfc3339_micros(SystemTime::now()).to_string(),
            "level": "INFO",
            "message": words,
            "target": module_path!(),
        })
        .to_string(),
    };
    let mut out = std::io::stdout();
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

/// Prints what to try with the sample session: a text to copy on a terminal, else lines of the log.
pub(super) fn print_sample_address(base: &str, id: &str, format: LogFormat) {
    let session = format!("{base}/v1/sessions/{id}");
    let body = r#"{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, -0.8, 0.4]}}]}}"#;
    let tries = [
        format!("curl -s {session}"),
        format!(
            "curl -s {session}/solve -H 'content-type: application/json' -H 'accept: model/gltf-binary' -o turned.glb -d '{body}'"
        ),
        format!("curl -s -X POST {session}/undo"),
        format!("curl -s '{session}/model?format=obj' -o creature.obj"),
    ];
    let mut err = std::io::stderr();
    if format == LogFormat::Json || !err.is_terminal() {
        for line in &tries {
            tracing::info!("to try: {line}");
        }
        return;
    }
    let listed: String = tries.iter().map(|line| format!("  {line}\n")).collect();
    let text = format!(
        "\nA sample session is open: a creature with fixed feet and a movable head. Open {base}/ to see it, or try:\n\n{listed}\n"
    );
    let _ = err.write_all(text.as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::config::KeyValue;
    use clap::{Args as _, FromArgMatches as _};

    #[test]
    fn sample_needs_no_value() {
        let command = ServeArgs::augment_args(clap::Command::new("serve"));
        let matches = command.try_get_matches_from(["serve", "--sample"]).unwrap();
        let args = ServeArgs::from_arg_matches(&matches).unwrap();
        assert_eq!(args.keys.sample, Some(KeyValue::Text("true".to_owned())));
    }
}
