//! Which server is loaded: one on loopback, or one in this process.

use crate::failure::LoadtestFailure;
use pliant::{server, session};
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::{TcpListener, lookup_host};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic::transport::{Channel, Endpoint, Uri};

/// How long connecting may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// A server that may be loaded.
pub(crate) struct LoadedServer {
    address: SocketAddr,
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
                address: resolve_loopback(url).await?,
                own: None,
            }),
            None => Self::start_own()
                .await
                .map_err(|problem| LoadtestFailure::Server(format!("cannot start a server: {problem}"))),
        }
    }

    async fn start_own() -> Result<Self, String> {
        let manager = session::Manager::new(session::SessionConfig::default()).map_err(|e| e.to_string())?;
        Self::serve(manager).await
    }

    /// A server of this process with these sessions.
    pub async fn serve(manager: session::Manager) -> Result<Self, String> {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.map_err(|e| e.to_string())?;
        let address = listener.local_addr().map_err(|e| e.to_string())?;
        let (stop, stopped) = oneshot::channel::<()>();
        let wait = async move {
            let _ = stopped.await;
        };
        let done = tokio::spawn(server::run(listener, manager, server::ServerConfig::default(), wait));
        Ok(Self {
            address,
            own: Some(OwnServer { stop, done }),
        })
    }

    /// A connection.
    pub async fn open_channel(&self) -> Result<Channel, LoadtestFailure> {
        let endpoint = Endpoint::from_shared(format!("http://{}", self.address));
        let endpoint = endpoint
            .map_err(|e| LoadtestFailure::Usage(e.to_string()))?
            .connect_timeout(PATIENCE);
        endpoint.connect().await.map_err(|e| {
            let cause = std::error::Error::source(&e).map_or_else(|| e.to_string(), ToString::to_string);
            LoadtestFailure::Server(format!("cannot connect to {}: {cause}", self.address))
        })
    }

    /// Stops a server of this process and waits until it has drained; leaves any other alone.
    pub async fn stop_own(self) -> Result<(), LoadtestFailure> {
        let Some(own) = self.own else { return Ok(()) };
        let _ = own.stop.send(());
        match own.done.await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(e)) => Err(LoadtestFailure::Server(e.to_string())),
            Err(e) => Err(LoadtestFailure::Server(format!(
                "the server in this process failed: {e}"
            ))),
        }
    }
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
