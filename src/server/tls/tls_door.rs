//! Handshakes, with the files as they are now.

use super::certificate_tenant::certificate_tenant;
use super::tls_config::TlsConfig;
use super::tls_files::TlsFiles;
use arc_swap::ArcSwap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::server::TlsStream;

/// Makes handshakes. Cloning shares the files.
#[derive(Clone)]
pub(in crate::server) struct TlsDoor(Arc<Door>);

struct Door {
    config: TlsConfig,
    files: Mutex<TlsFiles>,
    now: ArcSwap<ServerConfig>,
}

impl TlsDoor {
    /// Reads and checks the files.
    ///
    /// # Errors
    /// The file and what is wrong with it.
    pub fn open(config: &TlsConfig) -> Result<Self, String> {
        let files = TlsFiles::read(config)?;
        let now = files.server_config(config)?;
        Ok(Self(Arc::new(Door {
            config: config.clone(),
            files: Mutex::new(files),
            now: ArcSwap::from_pointee(now),
        })))
    }

    /// Whether clients may show certificates.
    pub fn takes_certificates(&self) -> bool {
        self.0.config.client_ca.is_some()
    }

    /// Looks at the files again; whether they had changed. Handshakes from now on use what is there, those that were made stay.
    ///
    /// # Errors
    /// The file and what is wrong with it; what was there before stays in use.
    pub fn reload(&self) -> Result<bool, String> {
        let seen = TlsFiles::read(&self.0.config)?;
        let mut files = self.0.files.lock().unwrap_or_else(PoisonError::into_inner);
        if *files == seen {
            return Ok(false);
        }
        let made = seen.server_config(&self.0.config);
        // What is wrong is told once, not at every look.
        *files = seen;
        self.0.now.store(Arc::new(made?));
        Ok(true)
    }

    /// Makes the handshake of a connection, and tells the tenant that the client's certificate names. A certificate of another
    /// authority ends it.
    pub async fn shake_hands(&self, socket: TcpStream) -> io::Result<(TlsStream<TcpStream>, Option<String>)> {
        let stream = TlsAcceptor::from(self.0.now.load_full()).accept(socket).await?;
        let (_, facts) = stream.get_ref();
        let shown = facts.peer_certificates().and_then(|chain| chain.first());
        let tenant = shown.and_then(|leaf| certificate_tenant(leaf.as_ref(), self.0.config.client_tenant));
        Ok((stream, tenant))
    }
}
