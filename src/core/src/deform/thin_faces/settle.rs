//! Thin faces brought to follow what is around them.

use super::{Cap, NeedlesAndCaps};
use crate::deform::body::DeformableBody;
use crate::deform::first_pass::frame::LocalFrame;
use crate::deform::handles::system::HandleSystem;
use crate::pool::Pool;
use glam::{DVec3, Mat3};
use rayon::prelude::*;
use std::borrow::Cow;

/// How often corners of caps are brought to their edges, whose ends may be corners of others.
const SWEEPS: usize = 3;

impl NeedlesAndCaps {
    /// Moves the corners of thin faces to where the shape around them is. What handles hold stays, and so does what has
    /// not moved. `positions` and `frames` are by node, as in [`crate::deform::PoseSolution`].
    pub fn settle(
        &self,
        body: &DeformableBody,
        handles: &HandleSystem,
        frames: &[LocalFrame],
        positions: &mut [DVec3],
        pool: &Pool,
    ) {
        if self.is_empty() || frames.len() != positions.len() {
            return;
        }
        // What is tied to another part stays at its place beside it.
        let mut held = Cow::Borrowed(handles.held_nodes());
        for anchor in body.graph.ties.iter().flat_map(|ties| ties.anchors()) {
            let held = held.to_mut();
            held[anchor.vertex as usize] = true;
            anchor.corners.iter().for_each(|&v| held[v as usize] = true);
        }
        let shape = PosedNodes {
            rest: &body.graph.positions,
            frames,
            held: &held,
        };
        let averaged = |row: usize| self.averaged(row, &shape, positions);
        let moved: Vec<Option<DVec3>> = pool.install(|| {
            (0..self.crowded.len())
                .into_par_iter()
                .with_min_len(64)
                .map(averaged)
                .collect()
        });
        for (&vertex, place) in self.crowded.iter().zip(moved) {
            if let Some(place) = place {
                positions[vertex as usize] = place;
            }
        }
        for _sweep in 0..SWEEPS {
            self.caps
                .iter()
                .for_each(|cap| self.follow_edge(cap, &shape, positions));
        }
    }

    /// Brings the corner of a cap to its edge, and those that it is crowded with along.
    fn follow_edge(&self, cap: &Cap, shape: &PosedNodes<'_>, positions: &mut [DVec3]) {
        let apex = cap.apex as usize;
        let [a, b] = cap.edge.map(|v| v as usize);
        if shape.held[apex] || [apex, a, b].iter().all(|&v| positions[v] == shape.rest[v]) {
            return;
        }
        let foot = shape.rest[a].lerp(shape.rest[b], cap.along);
        let on_edge = positions[a].lerp(positions[b], cap.along) + shape.turned(apex, shape.rest[apex] - foot);
        let share = if cap.weight.is_finite() {
            cap.weight / (1.0 + cap.weight)
        } else {
            1.0
        };
        let step = (on_edge - positions[apex]) * share;
        positions[apex] += step;
        let Ok(row) = self.crowded.binary_search(&cap.apex) else {
            return;
        };
        for &other in self.crowds.of(row as u32) {
            let other = other as usize;
            if !shape.held[other] && other != a && other != b {
                let away = shape.rest[other].distance_squared(shape.rest[apex]);
                positions[other] += step * fade(away / (self.reach[row] * self.reach[row]));
            }
        }
    }

    /// Where a crowded vertex goes; `None` when it stays.
    fn averaged(&self, row: usize, shape: &PosedNodes<'_>, positions: &[DVec3]) -> Option<DVec3> {
        let vertex = self.crowded[row] as usize;
        let crowd = self.crowds.of(row as u32);
        let is_still = |v: usize| positions[v] == shape.rest[v];
        if shape.held[vertex] || (is_still(vertex) && crowd.iter().all(|&v| is_still(v as usize))) {
            return None;
        }
        let here = shape.rest[vertex];
        let (mut sum, mut weights) = (positions[vertex], 1.0);
        for &other in crowd {
            let other = other as usize;
            let away = here - shape.rest[other];
            let share = away.length_squared() / (self.reach[row] * self.reach[row]);
            // What is held does not come half of the way.
            let weight = if shape.held[other] {
                fade(share) / share.max(1e-12)
            } else {
                fade(share)
            };
            sum += (positions[other] + shape.turned(other, away)) * weight;
            weights += weight;
        }
        Some(sum / weights)
    }
}

/// How much a vertex counts at a share of the reach, squared: 1 at the middle, 0 with a flat end at the reach.
fn fade(share: f64) -> f64 {
    (1.0 - share).max(0.0) * (1.0 - share).max(0.0)
}

/// Nodes and how they are turned.
struct PosedNodes<'a> {
    rest: &'a [DVec3],
    frames: &'a [LocalFrame],
    held: &'a [bool],
}

impl PosedNodes<'_> {
    /// A vector at a node as the node is turned and scaled.
    fn turned(&self, node: usize, vector: DVec3) -> DVec3 {
        Mat3::from_cols_array(&self.frames[node]).as_dmat3() * vector
    }
}
