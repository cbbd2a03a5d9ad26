//! What each tenant may use, and what it uses.

pub(crate) mod tenant_account;
pub(crate) mod tenant_quota;
