//! Fits and right-hand sides in single precision, for poses that come many a second and are solved to a thousandth.
//!
//! Rotations and frames are kept in single precision anyway; here the sums over edges are too. Edges are differences of
//! positions around the middle of the model, about unit size, so a fit is off by some 1e-5 and a right-hand side by some 1e-6
//! of an edge. What is gathered for a neighbour lies in one cache line.

use crate::body::{DeformableBody, SingleRest};
use crate::first_pass::blend::{LocalFrame, LocalRotation, pack_rotation};
use glam::{DVec3, Mat3, Mat3A, Quat, Vec3A};
use pliant_exec::pool::Pool;
use pliant_mesh::rotation::nearest_rotation_within;
use rayon::prelude::*;

/// Fits end with a step whose square is below this, radians, and are off by about as much.
const NEAR_ENOUGH: f64 = 1e-6;

/// Rotations of nodes fitted without scales, soft rotations or smoothing.
pub(crate) struct QuickFit<'a> {
    pub body: &'a DeformableBody,
    /// The first pass's rotations.
    pub first: &'a [LocalRotation],
    /// How far a fit goes, where 1 is to the rotation that fits best.
    pub reach: f32,
}

impl QuickFit<'_> {
    /// The first pass's rotations, turned by what refinement had added to them in the pose before.
    pub fn resume(
        &self,
        extra: &[LocalRotation],
        is_open: impl Fn(usize) -> bool + Sync,
        pool: &Pool,
    ) -> Vec<LocalRotation> {
        pool.map(self.first.len(), 1024, |i| match is_open(i) {
            true => (quat(extra[i]) * quat(self.first[i])).normalize().to_array(),
            false => self.first[i],
        })
    }

    /// What refinement has added to the first pass's rotations.
    pub fn extra(&self, turns: &[LocalRotation], pool: &Pool) -> Vec<LocalRotation> {
        pool.map(self.first.len(), 1024, |i| {
            (quat(turns[i]) * quat(self.first[i]).inverse()).to_array()
        })
    }

    /// Frames with these rotations.
    pub fn frames(&self, turns: &[LocalRotation], pool: &Pool) -> Vec<LocalFrame> {
        frames_of(turns, pool)
    }

    /// One fit of all open nodes to `x` (solving coordinates, three numbers a node, any origin).
    pub fn step(
        &self,
        turns: &[LocalRotation],
        x: &[f64],
        is_open: impl Fn(usize) -> bool + Sync,
        pool: &Pool,
    ) -> Vec<LocalRotation> {
        let rest = &self.body.single_rest().positions;
        let now = |i: usize| DVec3::from_slice(&x[3 * i..3 * i + 3]).as_vec3a();
        let places: Vec<[Vec3A; 2]> = pool.map(rest.len(), 1024, |i| [rest[i], now(i)]);
        pool.map(rest.len(), 1024, |i| match is_open(i) {
            true => self.fitted(i, turns[i], &places),
            false => turns[i],
        })
    }

    fn fitted(&self, i: usize, turn: LocalRotation, places: &[[Vec3A; 2]]) -> LocalRotation {
        let [rest, here] = places[i];
        let mut sum = Mat3A::ZERO;
        for_edges(self.body, i, |j, w| {
            let [other_rest, other] = places[j];
            let (edge, now) = (rest - other_rest, (here - other) * w);
            sum.x_axis += now * edge.x;
            sum.y_axis += now * edge.y;
            sum.z_axis += now * edge.z;
        });
        let from = quat(turn);
        let best = nearest_rotation_within(Mat3::from(sum).as_dmat3(), from.as_dquat().normalize(), NEAR_ENOUGH);
        let best = quat(pack_rotation(best));
        let best = if best.dot(from) < 0.0 { -best } else { best };
        (from * (1.0 - self.reach) + best * self.reach).normalize().to_array()
    }
}

/// The frames of rotations.
pub(crate) fn frames_of(turns: &[LocalRotation], pool: &Pool) -> Vec<LocalFrame> {
    pool.map(turns.len(), 1024, |i| Mat3::from_quat(quat(turns[i])).to_cols_array())
}

/// Equation (8)'s right-hand side on the nodes that are not given, three numbers each, without ties and soft pulls.
pub(crate) fn fill_right_hand_side(
    body: &DeformableBody,
    frames: &[LocalFrame],
    given: &[bool],
    rhs: &mut [f64],
    pool: &Pool,
) {
    let SingleRest { positions, laplacian } = body.single_rest();
    let framed: Vec<(Mat3A, Vec3A)> = pool.map(frames.len(), 1024, |i| {
        (Mat3A::from_cols_array(&frames[i]), positions[i])
    });
    pool.install(|| {
        let rows = rhs.as_chunks_mut::<3>().0.par_iter_mut().with_min_len(1024).enumerate();
        rows.filter(|(i, _)| !given[*i]).for_each(|(i, row)| {
            let (own, here) = framed[i];
            let mut sum = own * laplacian[i];
            for_edges(body, i, |j, w| {
                let (frame, other) = framed[j];
                sum += frame * ((here - other) * w);
            });
            *row = (sum * 0.5).as_dvec3().to_array();
        });
    });
}

/// Calls for each neighbour of a node, with the weight of the edge.
#[inline(always)]
fn for_edges(body: &DeformableBody, node: usize, mut edge: impl FnMut(usize, f32)) {
    let row = body.graph.offsets[node] as usize..body.graph.offsets[node + 1] as usize;
    let neighbours = &body.graph.neighbours[row.clone()];
    match body.graph.weights.as_deref() {
        None => neighbours.iter().for_each(|&j| edge(j as usize, 1.0)),
        Some(weights) => (neighbours.iter().zip(&weights[row])).for_each(|(&j, &w)| edge(j as usize, w)),
    }
}

fn quat(turn: LocalRotation) -> Quat {
    Quat::from_array(turn)
}
