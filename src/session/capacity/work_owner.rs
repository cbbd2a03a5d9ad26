//! Whose work it is.

use crate::session::answers::Tenant;

/// Whose work it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::session) struct WorkOwner {
    pub tenant: Tenant,
    /// Empty for sessions that are being opened: those of one tenant share a line.
    pub session: String,
}
