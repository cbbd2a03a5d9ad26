//! Names of topologies.

/// Names a state of a deformer's topology. Numbers are given in the order in which a deformer reaches new states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct TopologyId(pub(super) u64);

impl TopologyId {
    /// The name after this one.
    pub(super) fn next(self) -> Self {
        Self(self.0 + 1)
    }
}
