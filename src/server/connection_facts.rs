//! What is known of the connection that a request came by.

use super::auth::Principal;
use crate::session::Tenant;

/// What is known of a connection; travels with each of its requests.
#[derive(Debug, Clone)]
pub(super) struct ConnectionFacts {
    /// Who the client's certificate says it is.
    pub shown: Option<Principal>,
}

impl ConnectionFacts {
    /// The facts of a connection whose client has shown a certificate of `tenant`, or none.
    pub fn new(tenant: Option<String>) -> Self {
        Self {
            shown: tenant.map(|name| Principal {
                tenant: Tenant(name.as_str().into()),
                name: name.into(),
                reads_metrics: false,
            }),
        }
    }
}
