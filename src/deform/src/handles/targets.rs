//! Holds whose nodes have a place each: where they are wanted, and how much.
//!
//! New places change right-hand sides alone. New weights change the diagonal of the system that positions are solved with, which is
//! made again; fields of the first pass know nothing of either, for such a hold constrains positions alone.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::handles::ownership::NodeOwnership;
use crate::handles::system::{HandleSystem, PositionSystems, settle_parts};
use crate::second_pass::state::SolveState;
use glam::DVec3;
use pliant_exec::Exec;

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
    /// By component of the graph, whether a pull wants it elsewhere than at rest.
    moved: Vec<bool>,
}

impl PulledPlaces {
    fn of(body: &DeformableBody, position: &NodeOwnership, all: &[HoldTargets], system: &HandleSystem) -> Self {
        let mut of_hold: Vec<Option<(&HoldTargets, usize)>> = vec![None; system.handle_count()];
        all.iter()
            .for_each(|targets| of_hold[targets.hold] = Some((targets, 0)));
        let mut moved = vec![false; body.graph.components];
        let mut place = |&(node, hold, _): &(u32, u32, f64)| {
            let Some((targets, next)) = of_hold.get_mut(hold as usize).and_then(Option::as_mut) else {
                return DVec3::ZERO;
            };
            // Both lists rise by node; pulls without a say are left out of this one.
            let pulls = &system.setup.handles[hold as usize].pulls;
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

    /// Marks the components in which a pull wants a node elsewhere than at rest.
    pub fn mark_moved(&self, moved: &mut [bool]) {
        moved.iter_mut().zip(&self.moved).for_each(|(all, own)| *all |= own);
    }

    pub fn byte_size(&self) -> usize {
        self.places.capacity() * size_of::<DVec3>() + self.has_targets.capacity() + self.moved.capacity()
    }
}

impl HandleSystem {
    /// Replaces the targets in force by those of some holds, at most once each; the others have none. `state` goes on from its last
    /// solution, unless another part of the body is free of constraints now. On an error nothing has changed.
    ///
    /// # Errors
    /// [`Error::NoPosition`], [`Error::FreePart`] where weights of 0 leave no constraint; [`Error::Solver`], [`Error::Cancelled`].
    pub fn set_targets(
        &mut self,
        body: &DeformableBody,
        targets: &[HoldTargets],
        state: &mut SolveState,
        exec: &Exec<'_>,
    ) -> Result<(), Error> {
        let is_kept = |t: &HoldTargets| {
            let pulls = self.setup.handles[t.hold].pulls.iter();
            pulls.map(|p| p.1).eq(t.weights.iter().copied())
        };
        if !targets.iter().all(is_kept) {
            let before: Vec<Vec<f64>> = targets
                .iter()
                .map(|t| self.exchange_weights(t.hold, &t.weights))
                .collect();
            let position = NodeOwnership::settle(&self.setup, body.nodes(), |h| h.position);
            let made = settle_parts(body, &self.setup, &position).and_then(|(covered, parts)| {
                let systems = PositionSystems::make(body, &self.setup, &position, &covered, None, exec)?;
                Ok((parts, systems))
            });
            let (parts, systems) = match made {
                Ok(made) => made,
                Err(error) => {
                    for (t, weights) in targets.iter().zip(before) {
                        self.exchange_weights(t.hold, &weights);
                    }
                    return Err(error);
                }
            };
            match systems.positions.fixed == self.positions.fixed {
                true => state.rows.hand_over(body, &mut state.x),
                false => state.forget(),
            }
            (self.position, self.parts) = (position, parts);
            (self.positions, self.rigid, self.stiff) = (systems.positions, systems.rigid, systems.stiff);
        }
        self.places = match targets.is_empty() {
            true => PulledPlaces::default(),
            false => PulledPlaces::of(body, &self.position, targets, self),
        };
        Ok(())
    }

    fn exchange_weights(&mut self, hold: usize, weights: &[f64]) -> Vec<f64> {
        let pulls = self.setup.handles[hold].pulls.iter_mut();
        pulls
            .zip(weights)
            .map(|(pull, &w)| std::mem::replace(&mut pull.1, w))
            .collect()
    }
}
