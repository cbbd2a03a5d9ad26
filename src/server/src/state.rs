//! The state that all calls of the server share.

use super::auth::Authenticator;
use super::config::ServerConfig;
use super::telemetry::Telemetry;
use super::tls::TlsAcceptor;
use super::uploads::{HeldUpload, UploadBudget};
use pliant_mcp::HttpAgents;
use pliant_session::{Error, Manager, Tenant};
use std::sync::Arc;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// Shared by all connections of one server. Cloning shares it.
#[derive(Clone)]
pub(super) struct ServerState(Arc<Inner>);

pub(super) struct Inner {
    /// The sessions.
    pub manager: Manager,
    /// How connections are treated.
    pub config: ServerConfig,
    /// Identifies callers.
    pub authenticator: Authenticator,
    /// Negotiates TLS, if the server uses it.
    pub tls: Option<TlsAcceptor>,
    /// Counts.
    pub telemetry: Telemetry,
    /// Bytes of uploads on their way.
    pub uploads: UploadBudget,
    /// Cancelled as soon as the server is asked to stop: no new work from then on.
    pub draining: CancellationToken,
    /// Cancelled when what is still open must end now.
    pub closing: CancellationToken,
    /// Cancelled when every connection that is still open is dropped.
    pub dropped: CancellationToken,
    /// WebSockets, which no connection tracks once they are upgraded.
    pub sockets: TaskTracker,
    /// Bytes of one control message.
    pub message_bytes: usize,
    /// The tools of agents.
    pub agents: HttpAgents,
}

impl ServerState {
    /// Starts an upload of a tenant; rejects one whose announced length is too large before any of it is read.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where it is too large, or the tenant's quota is used up.
    pub fn hold_upload(&self, tenant: &Tenant, announced: Option<u64>) -> Result<HeldUpload, Error> {
        let account = self.manager.account(tenant)?;
        if let Some(bytes) = announced {
            self.uploads.announce(bytes)?;
            account.check_upload(bytes)?;
        }
        Ok(self.uploads.hold(Some(&account)).of_tenant(account))
    }

    /// The state of a new server.
    ///
    /// # Errors
    /// A text, when the keys that tokens are checked with cannot be used.
    pub fn new(manager: Manager, config: ServerConfig, tls: Option<TlsAcceptor>) -> Result<Self, String> {
        let certificates = tls.as_ref().is_some_and(TlsAcceptor::takes_certificates);
        let authenticator = Authenticator::new(&config.auth, certificates)?;
        let sessions = manager.config();
        let uploads = UploadBudget::new(sessions.upload_bytes, sessions.memory_bytes / 2, &manager);
        let message_bytes = usize::try_from(sessions.message_bytes).unwrap_or(usize::MAX);
        let telemetry = Telemetry::new();
        let agents = HttpAgents::new(&manager);
        Ok(Self(Arc::new(Inner {
            agents,
            manager,
            config,
            authenticator,
            tls,
            telemetry,
            uploads,
            draining: CancellationToken::new(),
            closing: CancellationToken::new(),
            dropped: CancellationToken::new(),
            sockets: TaskTracker::new(),
            message_bytes,
        })))
    }
}

impl std::ops::Deref for ServerState {
    type Target = Inner;

    fn deref(&self) -> &Inner {
        &self.0
    }
}
