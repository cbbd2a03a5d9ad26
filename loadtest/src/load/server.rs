//! Which server is loaded: one on loopback, or one in this process.

use crate::failure::{LoadtestFailure, block_on};
use pliant::server::{self, ServerConfig};
use pliant::session::{Manager, SessionConfig};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader};
use tokio::net::{TcpListener, lookup_host};
use tokio::process::{Child, Command};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic::transport::{Channel, Endpoint, Uri};

/// A server that may be loaded.
pub(crate) struct LoadedServer {
    /// `http://` and its address.
    pub url: String,
    own: Option<OwnServer>,
}

/// A server of this process.
struct OwnServer {
    stop: oneshot::Sender<()>,
    done: JoinHandle<Result<(), server::Error>>,
}

impl LoadedServer {
    /// The server at `url`, or one that starts here.
    ///
    /// # Errors
    /// When the address is not one of this machine's loopback, or cannot be had.
    pub async fn connect_or_start(url: Option<&str>) -> Result<Self, LoadtestFailure> {
        match url {
            Some(url) => Ok(Self {
                url: format!("http://{}", resolve_loopback(url).await?),
                own: None,
            }),
            None => Self::serve(Manager::new(SessionConfig::default())?).await,
        }
    }

    /// A server of this process with these sessions.
    pub async fn serve(manager: Manager) -> Result<Self, LoadtestFailure> {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await?;
        let address = listener.local_addr()?;
        let (stop, stopped) = oneshot::channel::<()>();
        let wait = async move {
            let _ = stopped.await;
        };
        let done = tokio::spawn(server::run(listener, manager, ServerConfig::default(), wait));
        Ok(Self {
            url: format!("http://{address}"),
            own: Some(OwnServer { stop, done }),
        })
    }

    /// Stops a server of this process and waits until it has drained; leaves any other alone.
    pub async fn stop_own(self) -> Result<(), LoadtestFailure> {
        let Some(own) = self.own else { return Ok(()) };
        let _ = own.stop.send(());
        Ok(own.done.await??)
    }
}

/// A connection to a server.
pub(crate) async fn connect(url: &str) -> Result<Channel, LoadtestFailure> {
    let endpoint = Endpoint::from_shared(url.to_owned()).map_err(LoadtestFailure::usage)?;
    endpoint.connect_timeout(PATIENCE).connect().await.map_err(|e| {
        let cause = std::error::Error::source(&e).map_or_else(|| e.to_string(), ToString::to_string);
        LoadtestFailure::Server(format!("cannot connect to {url}: {cause}"))
    })
}

/// The address of a URL, when every address of its host is this machine's own.
async fn resolve_loopback(url: &str) -> Result<SocketAddr, LoadtestFailure> {
    let refuse =
        |problem: &str| LoadtestFailure::Usage(format!("--server {url}: {problem}, such as http://127.0.0.1:7411"));
    let uri: Uri = url
        .parse()
        .map_err(|_| refuse("is not a URL; allowed is http:// with a loopback address"))?;
    if uri.scheme_str() != Some("http") {
        return Err(refuse("allowed is http:// with a loopback address"));
    }
    let host = uri.host().unwrap_or_default().trim_matches(['[', ']']);
    let found = lookup_host((host, uri.port_u16().unwrap_or(80))).await;
    let addresses: Vec<SocketAddr> = found
        .map_err(|e| refuse(&format!("cannot be found ({e}); name a loopback address")))?
        .collect();
    if !addresses.iter().all(|a| a.ip().is_loopback()) {
        return Err(refuse("is not this machine; a load test loads loopback addresses only"));
    }
    addresses
        .first()
        .copied()
        .ok_or_else(|| refuse("has no address; name a loopback address"))
}

/// How long the process may take to start, and to end, and connecting.
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
    server::use_one_heap();
    block_on(async {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await?;
        let address = listener.local_addr()?;
        let defaults = SessionConfig::default();
        let config = SessionConfig {
            sessions: 256,
            compute_queue: args.queue.unwrap_or(defaults.compute_queue),
            ..defaults
        };
        let manager = Manager::new(config)?;
        println!("http://{address}");
        let input_ends = async {
            let _ = tokio::io::stdin().read(&mut [0]).await;
        };
        Ok(server::run(listener, manager, ServerConfig::default(), input_ends).await?)
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
    /// Starts it; so many pieces of work may wait to be computed.
    pub async fn start(queue: Option<u32>) -> Result<Self, LoadtestFailure> {
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
            let read = tokio::time::timeout(PATIENCE, BufReader::new(stdout).read_line(&mut line)).await;
            read.map_err(|_| LoadtestFailure::Server("the server does not start".into()))?
                .map_err(failed)?;
        }
        let url = line.trim().to_owned();
        if !url.starts_with("http://127.0.0.1:") {
            return Err(LoadtestFailure::Server(format!("the server printed {url:?}")));
        }
        Ok(Self { child, url })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn only_loopback_is_loaded() {
        for url in ["http://127.0.0.1:7411", "http://127.9.9.9", "http://[::1]:80/"] {
            assert!(resolve_loopback(url).await.is_ok(), "{url}");
        }
        for url in [
            "http://192.0.2.1:7411",
            "http://0.0.0.0:7411",
            "http://[2001:db8::1]",
            "https://127.0.0.1",
            "127.0.0.1",
            "",
        ] {
            let Err(LoadtestFailure::Usage(text)) = resolve_loopback(url).await else {
                panic!("{url} was not refused")
            };
            assert!(
                text.contains("loopback") && text.contains("http://127.0.0.1:7411"),
                "{text}"
            );
        }
    }
}
