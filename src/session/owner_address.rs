//! Where a session is when it is not here.

/// The node that has a session, as callers are told.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnerAddress {
    /// The address that clients call, such as `https://10.0.0.5:7411`.
    pub address: String,
    /// Its name, by which a proxy before several nodes tells them apart.
    pub node: String,
}
