//! A request with its caller, read from its metadata.

use crate::server::auth;
use crate::server::messages::NamesSession;
use crate::server::state::ServerState;
use crate::session::{CallKey, Error, Manager, Tenant};
use prost::Message;
use tonic::{Request, Status};

/// A request with its caller.
pub(super) struct Call<T> {
    /// The sessions, with what is done noted as the caller's.
    pub manager: Manager,
    /// The caller's tenant.
    pub tenant: Tenant,
    /// The message, or the stream of messages.
    pub message: T,
    /// The idempotency key of a call that does work.
    pub key: Option<String>,
}

impl<T> Call<T> {
    /// A call by an authenticated caller.
    pub fn read(state: &ServerState, request: Request<T>) -> Result<Self, Status> {
        let principal = auth::principal(request.extensions())?;
        Ok(Self {
            manager: state.manager.on_behalf_of(&principal.name),
            tenant: principal.tenant.clone(),
            key: None,
            message: request.into_inner(),
        })
    }

    /// A call that does new work. It is rejected while the server shuts down; calls that only read are not.
    pub async fn work(state: &ServerState, request: Request<T>) -> Result<Self, Status> {
        let key = request.metadata().get("idempotency-key").cloned();
        let mut call = Self::read(state, request)?;
        if let Some(key) = key {
            let text = key.to_str();
            let text = text.map_err(|_| Error::invalid("idempotency-key", "is not printable ASCII"))?;
            call.key = Some(text.to_owned());
        }
        if state.draining.is_cancelled() {
            return Err(state.manager.leaving().await.into());
        }
        Ok(call)
    }
}

impl<T: NamesSession> Call<T> {
    /// Rejects a call on a session that does not exist, before its other fields are checked.
    pub async fn on_session(self, state: &ServerState) -> Result<Self, Status> {
        state.manager.get(&self.tenant, self.message.session_id()).await?;
        Ok(self)
    }
}

impl<T: Message> Call<T> {
    /// The idempotency key together with the request.
    pub fn call_key(&self) -> Option<CallKey> {
        call_key(self.key.clone(), &self.message)
    }
}

/// An idempotency key together with what identifies the request.
pub(super) fn call_key(key: Option<String>, request: &impl Message) -> Option<CallKey> {
    let request = |key| CallKey {
        key,
        request: request.encode_to_vec(),
    };
    key.map(request)
}
