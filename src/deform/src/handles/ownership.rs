//! What handles ask of graph nodes, and which of them constrains which node where they overlap.

use crate::body::DeformableBody;
use crate::handles::free_parts::FreePartPolicy;
use std::sync::Arc;

/// One handle, resolved to graph nodes.
#[derive(Debug, Clone, Default)]
pub struct HandleConstraint {
    /// The nodes of its region, rising.
    pub nodes: Vec<u32>,
    /// Nodes that it pulls, rising. For a soft handle with their weight, 0 to 1: its region with weight 1 (or the region's own
    /// weights) and the falloff around it. For a hard one the band of its falloff, which is not part of `nodes`, with the
    /// stiffness itself.
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
    pub(crate) fn is_loosely_rigid(&self) -> bool {
        self.rigid && !(self.position && self.stiffness.is_none())
    }
}

/// Which nodes are stiff, as asked for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StiffNodes {
    /// By node: the number of its part, or [`UNHELD`]; empty = no node is stiff.
    pub part_of: Vec<u32>,
    /// How far a part gives way: 1 is rigid, at 0 it would be as soft as without.
    pub strength: f64,
}

/// What a [`HandleSystem`](crate::HandleSystem) is built from.
#[derive(Debug, Clone, Default)]
pub struct HandleSetup {
    /// The handles; where hard ones overlap, the later one holds.
    pub handles: Vec<HandleConstraint>,
    /// Nodes that nothing may move (outside the region of interest), by node; empty = none. They win over every handle.
    pub frozen: Vec<bool>,
    /// What happens to parts without a position constraint.
    pub policy: FreePartPolicy,
    /// Nodes that move as rigid bodies where no hard handle holds any of theirs.
    pub stiff: StiffNodes,
}

/// In an owner list: a node without an owner.
pub const UNHELD: u32 = u32::MAX;

/// The handles that constrain one kind of quantity, by node.
#[derive(Debug, Clone, Default)]
pub struct NodeOwnership {
    /// By node: the hard holder, or [`UNHELD`]. What may not move at all belongs to one that comes after the last.
    pub hard: Arc<Vec<u32>>,
    /// Soft pulls (node, hold, stiffness) on nodes without a hard holder, by node then hold.
    pub soft: Arc<Vec<(u32, u32, f64)>>,
}

impl NodeOwnership {
    /// Settles overlaps for the holds that `constrains` accepts: the last one whose region contains a node has it, hard
    /// or soft. Pulls of soft holds add up, from the last hard one on; falloff never takes a node from a hard holder.
    pub(crate) fn settle(setup: &HandleSetup, nodes: usize, constrains: impl Fn(&HandleConstraint) -> bool) -> Self {
        let frozen_holder = setup.handles.len() as u32;
        let mut core = vec![UNHELD; nodes];
        let mut last_hard = vec![UNHELD; nodes];
        for (k, hold) in setup.handles.iter().enumerate().filter(|(_, h)| constrains(h)) {
            hold.nodes.iter().for_each(|&n| core[n as usize] = k as u32);
            if hold.stiffness.is_none() {
                hold.nodes.iter().for_each(|&n| last_hard[n as usize] = k as u32);
            }
        }
        for (owner, _) in core.iter_mut().zip(&setup.frozen).filter(|(_, frozen)| **frozen) {
            *owner = frozen_holder;
        }
        let is_hard = |k: u32| k == frozen_holder || setup.handles[k as usize].stiffness.is_none();
        let pulls = setup.handles.iter().filter(|h| constrains(h)).map(|h| h.pulls.len());
        let mut soft = Vec::with_capacity(pulls.sum());
        for (k, hold) in setup.handles.iter().enumerate().filter(|(_, h)| constrains(h)) {
            let stiffness = hold.stiffness.unwrap_or(1.0);
            let mut in_core = hold.nodes.iter().copied().peekable();
            for &(node, weight) in &hold.pulls {
                while in_core.peek().is_some_and(|&c| c < node) {
                    in_core.next();
                }
                let mine = in_core.peek() == Some(&node);
                let owner = core[node as usize];
                let comes_after = |hard: u32| hard == UNHELD || hard < k as u32;
                let allowed = owner == UNHELD || (!is_hard(owner) && (!mine || comes_after(last_hard[node as usize])));
                if allowed && weight > 0.0 {
                    soft.push((node, k as u32, stiffness * weight));
                }
            }
        }
        // No two are of one node and one hold, so that this is an order, and it needs no second list.
        soft.sort_unstable_by_key(|&(node, hold, _)| (node, hold));
        let hard = core
            .into_iter()
            .map(|k| if k != UNHELD && is_hard(k) { k } else { UNHELD })
            .collect();
        Self {
            hard: Arc::new(hard),
            soft: Arc::new(soft),
        }
    }

    /// Which holds constrain any node; the frozen surroundings come last.
    pub(crate) fn active(&self, holds: usize) -> Vec<bool> {
        let mut active = vec![false; holds + 1];
        self.hard
            .iter()
            .filter(|&&k| k != UNHELD)
            .for_each(|&k| active[k as usize] = true);
        self.soft.iter().for_each(|&(_, k, _)| active[k as usize] = true);
        active
    }

    /// Which components hold any constraint.
    pub(crate) fn covered(&self, body: &DeformableBody) -> Vec<bool> {
        let mut covered = vec![false; body.graph.components];
        for (node, _) in self.hard.iter().enumerate().filter(|(_, k)| **k != UNHELD) {
            covered[body.graph.component[node] as usize] = true;
        }
        for &(node, ..) in self.soft.iter() {
            covered[body.graph.component[node as usize] as usize] = true;
        }
        covered
    }

    /// Extra diagonal by node, `None` without soft pulls.
    pub fn stiffness(&self) -> Option<Vec<f64>> {
        if self.soft.is_empty() {
            return None;
        }
        let mut sum = vec![0.0; self.hard.len()];
        self.soft.iter().for_each(|&(node, _, s)| sum[node as usize] += s);
        Some(sum)
    }

    /// Where each node's soft pulls begin in the list, and the end; empty without any.
    pub fn first_pulls(&self) -> Vec<u32> {
        if self.soft.is_empty() {
            return Vec::new();
        }
        let nodes = self.hard.len();
        let mut first = vec![0; nodes + 1];
        self.soft.iter().for_each(|s| first[s.0 as usize + 1] += 1);
        (0..nodes).for_each(|i| first[i + 1] += first[i]);
        first
    }

    pub(crate) fn byte_size(&self) -> usize {
        self.hard.capacity() * 4 + self.soft.capacity() * size_of::<(u32, u32, f64)>()
    }

    pub(crate) fn same_as(&self, other: &Self) -> bool {
        self.shares_with(other) || (self.hard == other.hard && self.soft == other.soft)
    }

    /// Whether both are the same lists in memory.
    pub(crate) fn shares_with(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.hard, &other.hard) && Arc::ptr_eq(&self.soft, &other.soft)
    }
}
