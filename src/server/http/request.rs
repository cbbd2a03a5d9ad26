//! What every call brings: who asks, its idempotency key, and names in its path.

use super::problem::Problem;
use crate::server::auth;
use crate::server::state::State;
use crate::session::{CallKey, Error, Manager, Tenant};
use axum::extract::{FromRequestParts, Path};
use http::StatusCode;
use http::request::Parts;
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// Who asks, checked before anything else.
pub(in crate::server) struct Caller {
    /// The tenant.
    pub tenant: Tenant,
    /// What it is called, for the audit trail.
    name: Arc<str>,
    /// Whether it may read the counts of the whole server.
    pub reads_metrics: bool,
    /// The idempotency key, where one was sent.
    key: Option<Result<String, Error>>,
}

impl Caller {
    /// The sessions, with what is done noted as the caller's.
    pub fn manager(&self, state: &State) -> Manager {
        state.manager.on_behalf_of(&self.name)
    }

    /// The idempotency key. An invalid one fails here, not earlier, so that a missing session is reported first.
    pub fn key(&self) -> Result<Option<&str>, Error> {
        match &self.key {
            None => Ok(None),
            Some(Ok(key)) => Ok(Some(key)),
            Some(Err(error)) => Err(error.clone()),
        }
    }

    /// The idempotency key together with what identifies the request.
    pub fn call_key(&self, request: impl FnOnce() -> Vec<u8>) -> Result<Option<CallKey>, Error> {
        let with_request = |key: &str| CallKey {
            key: key.to_owned(),
            request: request(),
        };
        Ok(self.key()?.map(with_request))
    }
}

impl FromRequestParts<State> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &State) -> Result<Self, Problem> {
        let principal = auth::principal(&parts.extensions)?;
        let (tenant, name) = (principal.tenant.clone(), Arc::clone(&principal.name));
        let reads_metrics = principal.reads_metrics;
        let key = parts.headers.get("idempotency-key").map(|value| {
            let text = value
                .to_str()
                .map_err(|_| Error::invalid("Idempotency-Key", "is not printable ASCII"))?;
            Ok(text.to_owned())
        });
        Ok(Self {
            tenant,
            name,
            reads_metrics,
            key,
        })
    }
}

/// Names in the path.
pub(super) struct Names<T>(pub T);

impl<T: DeserializeOwned + Send> FromRequestParts<State> for Names<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &State) -> Result<Self, Problem> {
        match Path::<T>::from_request_parts(parts, state).await {
            Ok(Path(names)) => Ok(Self(names)),
            Err(_) => Err(Problem::new(
                StatusCode::BAD_REQUEST,
                "INVALID_ARGUMENT",
                "the path is not valid percent-encoded UTF-8",
            )),
        }
    }
}
