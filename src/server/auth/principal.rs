//! The caller of a request, as the rest of the server sees it.

use crate::session::{Error, ErrorCode, Tenant};
use http::Extensions;
use std::sync::Arc;

/// A caller that has proved who it is, or whom nobody asked because the server is open. Travels with the request.
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
    /// The caller of a server that asks nobody.
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
/// `UNAUTHENTICATED` where the door let the request in without one, as it does for pages that belong to nobody.
pub(in crate::server) fn principal(extensions: &Extensions) -> Result<&Principal, Error> {
    extensions.get::<Principal>().ok_or_else(unknown_caller)
}

/// The refusal of a request that proves nothing.
pub(super) fn unknown_caller() -> Error {
    Error::new(
        ErrorCode::Unauthenticated,
        "this server must know who asks; send a token in the header Authorization: Bearer TOKEN",
    )
}
