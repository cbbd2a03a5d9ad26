//! Where each node that a hold with targets pulls is wanted, in the order in which right-hand sides need it.

use crate::body::DeformableBody;
use crate::handles::ownership::{HandleSetup, NodeOwnership};
use crate::handles::pulled_points::PulledPoint;
use glam::DVec3;

/// Where the nodes that a soft hold pulls are wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct HoldTargets {
    /// The hold. It is soft, and constrains positions alone.
    pub hold: usize,
    /// By pull of the hold: the place, model space. Empty where `points` say it.
    pub places: Vec<DVec3>,
    /// Points that are wanted somewhere in the place of the nodes themselves; empty = the nodes are.
    pub points: Vec<PulledPoint>,
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
    /// By hold, whether it has points.
    has_points: Vec<bool>,
    /// The points of all holds, their weights times the stiffness.
    points: Vec<PulledPoint>,
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
            if !targets.points.is_empty() {
                return DVec3::ZERO;
            }
            let place = targets.places[*next];
            if place != body.graph.positions[node as usize] {
                moved[body.graph.component[node as usize] as usize] = true;
            }
            place
        };
        let places = position.soft.iter().map(&mut place).collect();
        let has_targets = of_hold.iter().map(Option::is_some).collect();
        let has_points = |of: &Option<(&HoldTargets, usize)>| of.is_some_and(|(targets, _)| !targets.points.is_empty());
        let has_points = of_hold.iter().map(has_points).collect();
        let mut points = Vec::new();
        for targets in all {
            let stiffness = setup.handles[targets.hold].stiffness.unwrap_or(1.0);
            let pulling = targets.points.iter().filter(|point| point.weight > 0.0);
            points.extend(pulling.map(|point| PulledPoint {
                weight: point.weight * stiffness,
                ..*point
            }));
        }
        for point in points.iter().filter(|point| point.place != point.at_rest(body)) {
            let of_node = |node: &u32| body.graph.component[*node as usize] as usize;
            point.nodes.iter().map(of_node).for_each(|part| moved[part] = true);
        }
        Self {
            places,
            has_targets,
            has_points,
            points,
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

    /// Whether a hold wants points somewhere in the place of the nodes that it pulls: each pull is then to where its node is, and
    /// [`Self::points`] say what is lacking.
    pub fn has_points(&self, hold: u32) -> bool {
        self.has_points.get(hold as usize) == Some(&true)
    }

    /// Whether any hold does.
    pub fn has_any_points(&self) -> bool {
        !self.points.is_empty()
    }

    /// All points, their weights times the stiffness of their holds.
    pub fn points(&self) -> &[PulledPoint] {
        &self.points
    }

    /// Whether any hold has targets.
    pub fn has_targets(&self) -> bool {
        self.has_targets.contains(&true)
    }

    /// Marks the components in which a pull wants a node elsewhere than in the rest pose.
    pub fn mark_moved(&self, moved: &mut [bool]) {
        moved.iter_mut().zip(&self.moved).for_each(|(all, own)| *all |= own);
    }

    pub fn byte_size(&self) -> usize {
        let holds = self.has_targets.capacity() + self.has_points.capacity();
        let points = self.points.capacity() * size_of::<PulledPoint>();
        self.places.capacity() * size_of::<DVec3>() + points + holds + self.moved.capacity()
    }
}
