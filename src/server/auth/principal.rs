//! The caller of a request, as the rest of the server sees it.

use crate::session::{Error, ErrorCode, Tenant};
use http::Extensions;
use std::sync::Arc;

/// An authenticated caller, or any caller of a server without authentication. Travels with the request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::server) struct Principal {
    /// Whose sessions it sees.
    pub tenant: Tenant,
    /// What it is called in logs: the name of its token, or the name in its certificate. Never a secret.
    pub name: Arc<str>,
    /// Whether it may read the counts of the whole server.
    pub reads_metrics: bool,
}

impl Principal {
    /// Any caller of an open server.
    pub fn anyone() -> Self {
        Self {
            tenant: Tenant::default(),
            name: "anyone".into(),
            reads_metrics: true,
        }
    }
}

/// The caller of a request.
///
/// # Errors
/// `UNAUTHENTICATED` where the gatekeeper admitted the request without one, as it does for public pages.
pub(in crate::server) fn principal(extensions: &Extensions) -> Result<&Principal, Error> {
    extensions.get::<Principal>().ok_or_else(unknown_caller)
}

/// Rejects a request without credentials.
pub(super) fn unknown_caller() -> Error {
    Error::new(
        ErrorCode::Unauthenticated,
        "this server needs a token; send it in the header Authorization: Bearer TOKEN",
    )
}
