//! Where each node that a hold with targets pulls is wanted, in the order in which right-hand sides need it.

use crate::body::DeformableBody;
use crate::handles::ownership::{HandleSetup, NodeOwnership};
use glam::DVec3;

/// Where the nodes that a soft hold pulls are wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct HoldTargets {
    /// The hold. It is soft, and constrains positions alone.
    pub hold: usize,
    /// By pull of the hold: the place, model space.
    pub places: Vec<DVec3>,
    /// By pull of the hold: its weight, 0 or more, in the place of the one in [`HandleConstraint::pulls`](super::HandleConstraint).
    pub weights: Vec<f64>,
}

/// The places in force.
#[derive(Debug, Default)]
pub(crate) struct PulledPlaces {
    /// By soft pull of the system, those of holds without targets unused; empty = no hold has targets.
    places: Vec<DVec3>,
    /// By hold, whether it has targets.
    has_targets: Vec<bool>,
    /// By component of the graph, whether a pull wants it elsewhere than in the rest pose.
    moved: Vec<bool>,
}

impl PulledPlaces {
    pub fn of(body: &DeformableBody, setup: &HandleSetup, position: &NodeOwnership, all: &[HoldTargets]) -> Self {
        let mut of_hold: Vec<Option<(&HoldTargets, usize)>> = vec![None; setup.handles.len()];
        all.iter()
            .for_each(|targets| of_hold[targets.hold] = Some((targets, 0)));
        let mut moved = vec![false; body.graph.components];
        let mut place = |&(node, hold, _): &(u32, u32, f64)| {
            let Some((targets, next)) = of_hold.get_mut(hold as usize).and_then(Option::as_mut) else {
                return DVec3::ZERO;
            };
            // Both lists rise by node; pulls without a say are left out of this one.
            let pulls = &setup.handles[hold as usize].pulls;
            while pulls[*next].0 < node {
                *next += 1;
            }
            let place = targets.places[*next];
            if place != body.graph.positions[node as usize] {
                moved[body.graph.component[node as usize] as usize] = true;
            }
            place
        };
        let places = position.soft.iter().map(&mut place).collect();
        let has_targets = of_hold.iter().map(Option::is_some).collect();
        Self {
            places,
            has_targets,
            moved,
        }
    }

    /// The place that a soft pull, given by its number among those of the system, wants; `None` where its hold has no targets.
    pub fn of_pull(&self, pull: usize, hold: u32) -> Option<DVec3> {
        match self.has_targets.get(hold as usize) {
            Some(true) => Some(self.places[pull]),
            _ => None,
        }
    }

    /// Whether a hold has targets.
    pub fn has_targets(&self) -> bool {
        self.has_targets.contains(&true)
    }

    /// Marks the components in which a pull wants a node elsewhere than in the rest pose.
    pub fn mark_moved(&self, moved: &mut [bool]) {
        moved.iter_mut().zip(&self.moved).for_each(|(all, own)| *all |= own);
    }

    pub fn byte_size(&self) -> usize {
        self.places.capacity() * size_of::<DVec3>() + self.has_targets.capacity() + self.moved.capacity()
    }
}
