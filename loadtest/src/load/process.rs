//! A server in a process of its own, whose memory, files and threads can be looked at.

use crate::failure::LoadtestFailure;
use pliant::server::{self, ServerConfig};
use pliant::session::{Manager, SessionConfig};
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader};
use tokio::net::TcpListener;
use tokio::process::{Child, Command};
use tonic::transport::{Channel, Endpoint};

/// How long the process may take to start, and to end.
const PATIENCE: Duration = Duration::from_secs(30);

/// The hidden command of this program that is the server.
pub(crate) const SERVER_COMMAND: &str = "own-server";

/// Arguments of the server.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct OwnServerArgs {
    /// Pieces of work that may wait to be computed; the server's own choice without it
    #[arg(long)]
    queue: Option<usize>,
}

/// Runs the server until the standard input ends.
pub(crate) fn run_own_server(args: &OwnServerArgs) -> Result<(), LoadtestFailure> {
    let failed = |e: &dyn std::fmt::Display| LoadtestFailure::Server(e.to_string());
    server::use_one_heap();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    runtime.map_err(|e| failed(&e))?.block_on(async {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.map_err(|e| failed(&e))?;
        let address = listener.local_addr().map_err(|e| failed(&e))?;
        let defaults = SessionConfig::default();
        let config = SessionConfig {
            sessions: 256,
            compute_queue: args.queue.unwrap_or(defaults.compute_queue),
            ..defaults
        };
        let manager = Manager::new(config).map_err(|e| failed(&e))?;
        println!("http://{address}");
        let input_ends = async {
            let _ = tokio::io::stdin().read(&mut [0]).await;
        };
        let served = server::run(listener, manager, ServerConfig::default(), input_ends).await;
        served.map_err(|e| failed(&e))
    })
}

/// What a process uses.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ProcessUse {
    /// Resident bytes.
    pub resident: u64,
    /// The most that were resident so far.
    pub peak: u64,
    /// Open files and connections.
    pub files: usize,
    /// Threads.
    pub threads: u64,
}

/// A server in a process of its own; it ends with this one.
pub(crate) struct ServerProcess {
    child: Child,
    /// `http://127.0.0.1:PORT`.
    pub url: String,
}

impl ServerProcess {
    /// Starts it as it is by default.
    pub async fn start() -> Result<Self, LoadtestFailure> {
        Self::start_with_queue(None).await
    }

    /// Starts it; so many pieces of work may wait to be computed.
    pub async fn start_with_queue(queue: Option<u32>) -> Result<Self, LoadtestFailure> {
        let failed = |e: std::io::Error| LoadtestFailure::Server(format!("cannot start a server: {e}"));
        let program: PathBuf = std::env::current_exe().map_err(failed)?;
        let mut command = Command::new(program);
        command
            .arg(SERVER_COMMAND)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .kill_on_drop(true);
        if let Some(queue) = queue {
            command.arg("--queue").arg(queue.to_string());
        }
        let mut child = command.spawn().map_err(failed)?;
        let mut line = String::new();
        if let Some(stdout) = child.stdout.take() {
            let said = tokio::time::timeout(PATIENCE, BufReader::new(stdout).read_line(&mut line)).await;
            said.map_err(|_| LoadtestFailure::Server("the server does not start".into()))?
                .map_err(failed)?;
        }
        let url = line.trim().to_owned();
        if !url.starts_with("http://127.0.0.1:") {
            return Err(LoadtestFailure::Server(format!("the server said {url:?}")));
        }
        Ok(Self { child, url })
    }

    /// A connection.
    pub async fn open_channel(&self) -> Result<Channel, LoadtestFailure> {
        let endpoint = Endpoint::from_shared(self.url.clone()).map_err(|e| LoadtestFailure::Server(e.to_string()))?;
        let connected = endpoint.connect_timeout(PATIENCE).connect().await;
        connected.map_err(|e| LoadtestFailure::Server(format!("cannot connect to {}: {e}", self.url)))
    }

    /// What the process uses now; zeros where the system has no figures.
    pub fn now_used(&self) -> ProcessUse {
        let Some(id) = self.child.id() else {
            return ProcessUse::default();
        };
        let status = std::fs::read_to_string(format!("/proc/{id}/status")).unwrap_or_default();
        let number = |key: &str| {
            let line = status
                .lines()
                .find_map(|line| line.strip_prefix(key)?.strip_prefix(':'));
            let word = line.and_then(|line| line.split_whitespace().next());
            word.and_then(|word| word.parse::<u64>().ok()).unwrap_or(0)
        };
        ProcessUse {
            resident: number("VmRSS") << 10,
            peak: number("VmHWM") << 10,
            files: std::fs::read_dir(format!("/proc/{id}/fd")).map_or(0, Iterator::count),
            threads: number("Threads"),
        }
    }

    /// Stops it, and waits for its end.
    pub async fn stop(mut self) -> Result<(), LoadtestFailure> {
        drop(self.child.stdin.take());
        match tokio::time::timeout(PATIENCE, self.child.wait()).await {
            Ok(Ok(status)) if status.success() => Ok(()),
            Ok(Ok(status)) => Err(LoadtestFailure::Server(format!("the server ended with {status}"))),
            Ok(Err(e)) => Err(LoadtestFailure::Server(format!("the server: {e}"))),
            Err(_) => Err(LoadtestFailure::Server("the server does not end".into())),
        }
    }
}
