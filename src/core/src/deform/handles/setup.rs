//! What a handle system is built from: handles resolved to graph nodes.

use crate::deform::handles::free_parts::FreePartPolicy;

/// One handle, resolved to graph nodes.
#[derive(Debug, Clone, Default)]
pub struct HandleConstraint {
    /// The nodes of its region, rising.
    pub nodes: Vec<u32>,
    /// For a soft handle: nodes that it pulls with their weight, 0 to 1, rising; its region with weight 1 (or the
    /// region's own weights) and the falloff around it. Empty for a hard one.
    pub pulls: Vec<(u32, f64)>,
    /// `None` for a hard handle, else the stiffness in units of edge weights.
    pub stiffness: Option<f64>,
    /// Whether it constrains positions.
    pub position: bool,
    /// Whether it constrains rotations.
    pub rotation: bool,
    /// Whether it constrains scale.
    pub scale: bool,
    /// Whether its region keeps its shape whatever moves it.
    pub rigid: bool,
}

impl HandleConstraint {
    /// Whether its region keeps its shape and no hard position says where it is: a solve finds that.
    pub(in crate::deform) fn is_loosely_rigid(&self) -> bool {
        self.rigid && !(self.position && self.stiffness.is_none())
    }
}

/// What a [`HandleSystem`] is built from.
#[derive(Debug, Clone, Default)]
pub struct HandleSetup {
    /// The handles; where hard ones overlap, the later one holds.
    pub handles: Vec<HandleConstraint>,
    /// Nodes that nothing may move (outside the region of interest), by node; empty = none. They win over every handle.
    pub frozen: Vec<bool>,
    /// What happens to parts without a position constraint.
    pub policy: FreePartPolicy,
}
