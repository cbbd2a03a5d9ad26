//! What each tenant may use, and what it uses.

pub(in crate::session) mod tenant_account;
pub(in crate::session) mod tenant_quota;
