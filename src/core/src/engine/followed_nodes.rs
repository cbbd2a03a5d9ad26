//! How the nodes of a graph that has followed an edit came about.

/// How the nodes of a graph that has followed an edit came about; empty when it was built.
#[derive(Debug, Default)]
pub(super) struct FollowedNodes {
    /// For each node its number before.
    pub old_from_new: Vec<u32>,
    /// Nodes that changed, rising.
    pub touched: Vec<u32>,
}
