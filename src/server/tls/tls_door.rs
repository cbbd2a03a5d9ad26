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
    files: Mutex<FollowedFiles>,
    now: ArcSwap<ServerConfig>,
}

struct FollowedFiles {
    /// What was read last, of each file that could be read.
    seen: TlsFiles,
    /// What handshakes use.
    used: TlsFiles,
    /// Why that is not all of what was read last.
    problem: Option<String>,
}

/// What came of a look at the files.
pub(in crate::server) struct TlsReload {
    /// Whether handshakes from now on use something else.
    pub has_changed: bool,
    /// The file that cannot be used, and why; what was read of it before stays in use.
    pub problem: Option<String>,
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
            files: Mutex::new(FollowedFiles {
                seen: files.clone(),
                used: files,
                problem: None,
            }),
            now: ArcSwap::from_pointee(now),
        })))
    }

    /// Whether clients may show certificates.
    pub fn takes_certificates(&self) -> bool {
        self.0.config.client_ca.is_some()
    }

    /// Looks at the files again. Handshakes from now on use what can be used of them, those that were made stay. The certificate with
    /// its key, and the authorities of clients, are followed each for itself: an authority that was taken away is not believed any
    /// longer because a certificate cannot be read.
    pub fn reload(&self) -> TlsReload {
        let config = &self.0.config;
        let (pair, client_ca) = (TlsFiles::read_pair(config), TlsFiles::read_client_ca(config));
        let unread = pair.as_ref().err().or(client_ca.as_ref().err()).cloned();
        let mut files = self.0.files.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = TlsFiles {
            pair: pair.unwrap_or_else(|_| files.seen.pair.clone()),
            client_ca: client_ca.unwrap_or_else(|_| files.seen.client_ca.clone()),
        };
        let mut has_changed = false;
        if seen != files.seen {
            let (problem, usable) = self.usable(&seen, &files.used);
            files.seen = seen;
            files.problem = problem;
            if let Some((used, made)) = usable {
                files.used = used;
                self.0.now.store(Arc::new(made));
                has_changed = true;
            }
        }
        TlsReload {
            has_changed,
            problem: unread.or_else(|| files.problem.clone()),
        }
    }

    /// What can be used of files instead of what is used now, and why it is not all of them.
    fn usable(&self, seen: &TlsFiles, used: &TlsFiles) -> (Option<String>, Option<(TlsFiles, ServerConfig)>) {
        let make = |files: &TlsFiles| files.server_config(&self.0.config);
        let problem = match make(seen) {
            Ok(made) => return (None, Some((seen.clone(), made))),
            Err(problem) => problem,
        };
        let with_old_pair = TlsFiles {
            pair: used.pair.clone(),
            ..seen.clone()
        };
        let with_old_ca = TlsFiles {
            client_ca: used.client_ca.clone(),
            ..seen.clone()
        };
        let parts = [with_old_pair, with_old_ca].into_iter();
        let mut parts = parts.filter(|files| files != used);
        let usable = parts.find_map(|files| make(&files).ok().map(|made| (files, made)));
        (Some(problem), usable)
    }

    /// Negotiates TLS on a connection, and returns the tenant that the client's certificate names. A certificate of
    /// another authority ends it.
    pub async fn shake_hands(&self, socket: TcpStream) -> io::Result<(TlsStream<TcpStream>, Option<String>)> {
        let stream = TlsAcceptor::from(self.0.now.load_full()).accept(socket).await?;
        let (_, facts) = stream.get_ref();
        let shown = facts.peer_certificates().and_then(|chain| chain.first());
        let tenant = shown.and_then(|leaf| certificate_tenant(leaf.as_ref(), self.0.config.client_tenant));
        Ok((stream, tenant))
    }
}
