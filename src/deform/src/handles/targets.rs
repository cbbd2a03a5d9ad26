//! Holds whose nodes have a place each: where they are wanted, and how much.
//!
//! New places change right-hand sides alone. New weights change the diagonal of the system that positions are solved with, which is
//! made again; fields of the first pass know nothing of either, for such a hold constrains positions alone.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::handles::ownership::NodeOwnership;
use crate::handles::pulled_places::{HoldTargets, PulledPlaces};
use crate::handles::system::{HandleSystem, PositionSystems, settle_parts};
use crate::second_pass::state::SolveState;
use pliant_exec::Exec;

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
            false => PulledPlaces::of(body, &self.setup, &self.position, targets),
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
