//! Where a session is when it is not here.

/// The node that has a session, for its callers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnerAddress {
    /// The address that clients call, such as `https://10.0.0.5:7411`.
    pub address: String,
    /// Its name, by which a proxy selects a node.
    pub node: String,
}
