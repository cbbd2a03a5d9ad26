//! What every call of the server can reach.

use super::auth::Gatekeeper;
use super::config::ServerConfig;
use super::telemetry::Telemetry;
use super::tls::TlsDoor;
use super::uploads::{Budget, Held};
use crate::session::{Error, Manager, Tenant};
use std::sync::Arc;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// Shared by all connections of one server. Cloning shares it.
#[derive(Clone)]
pub(super) struct State(Arc<Inner>);

pub(super) struct Inner {
    /// The sessions.
    pub manager: Manager,
    /// How connections are treated.
    pub config: ServerConfig,
    /// Who may call.
    pub gatekeeper: Gatekeeper,
    /// Where connections are encrypted.
    pub tls: Option<TlsDoor>,
    /// Counts.
    pub telemetry: Telemetry,
    /// Bytes of uploads on their way.
    pub uploads: Budget,
    /// Cancelled as soon as the server is asked to stop: no new work from then on.
    pub draining: CancellationToken,
    /// Cancelled when what is still open must end now.
    pub closing: CancellationToken,
    /// WebSockets, which no connection tracks once they are upgraded.
    pub sockets: TaskTracker,
    /// Bytes of one control message.
    pub message_bytes: usize,
}

impl State {
    /// Starts an upload of a tenant; one whose length is announced is refused before any of it is read.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where it is too large, or the tenant's quota is used up.
    pub fn hold_upload(&self, tenant: &Tenant, announced: Option<u64>) -> Result<Held, Error> {
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
    pub fn new(manager: Manager, config: ServerConfig, tls: Option<TlsDoor>) -> Result<Self, String> {
        let certificates = tls.as_ref().is_some_and(TlsDoor::takes_certificates);
        let gatekeeper = Gatekeeper::new(&config.auth, certificates)?;
        let sessions = manager.config();
        let uploads = Budget::new(sessions.upload_bytes, sessions.memory_bytes / 2, &manager);
        let message_bytes = usize::try_from(sessions.message_bytes).unwrap_or(usize::MAX);
        let telemetry = Telemetry::new(&manager);
        Ok(Self(Arc::new(Inner {
            manager,
            config,
            gatekeeper,
            tls,
            telemetry,
            uploads,
            draining: CancellationToken::new(),
            closing: CancellationToken::new(),
            sockets: TaskTracker::new(),
            message_bytes,
        })))
    }
}

impl std::ops::Deref for State {
    type Target = Inner;

    fn deref(&self) -> &Inner {
        &self.0
    }
}
