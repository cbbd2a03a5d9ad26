//! The second pass as a system of equations, before anything solves it (paper equations 8 and 11).
//!
//! With d_ij = ½ (M_i + M_j)(p_i − p_j), where M = R S is a node's frame, the right-hand side needs no d:
//! b_i = ½ M_i Σ w (p_i − p_j) + ½ Σ w M_j (p_i − p_j), and the first sum does not change with the pose. Constrained
//! neighbours enter through α and β inside the solver; soft handles add their stiffness.

use crate::body::DeformableBody;
use crate::first_pass::blend::{IDENTITY_FRAME, LocalFrame};
use crate::first_pass::spread::blend_frames_with;
use crate::handles::ownership::UNHELD;
use crate::handles::system::HandleSystem;
use crate::rotation::Transform;
use crate::second_pass::single_precision::fill_right_hand_side;
use glam::{DMat3, DVec3, Mat3};
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// What the second pass solves for one pose, apart from the matrix, which is the graph's Laplacian plus
/// [`HandleSystem::stiffness`] on the diagonal. Coordinates are [`DeformableBody::rest`]'s, around `center`.
#[derive(Debug, Clone)]
pub struct SecondPassEquations {
    /// Right-hand side by node, with the soft pulls and before given neighbours are moved into it; 0 on given nodes.
    pub rhs: Vec<[f64; 3]>,
    /// Positions by node: held positions of given nodes, rest positions of others.
    pub given: Vec<[f64; 3]>,
    /// The first-pass frames by node.
    pub frames: Vec<LocalFrame>,
    /// What `rhs` and `given` are relative to: the mean of what is held.
    pub center: [f64; 3],
}

/// How sums over edges are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Precision {
    /// As [`super::single_precision`] does.
    Single,
    Double,
}

/// A pose as the second pass sees it.
pub(crate) struct PosedHandles {
    pub frames: Vec<LocalFrame>,
    /// Solving coordinates of given nodes; rest elsewhere.
    pub targets: Vec<DVec3>,
    /// Solving around the mean of what is held makes the residual independent of where in space the model is.
    pub center: DVec3,
    /// How the right-hand side is summed up.
    pub precision: Precision,
}

/// What pulls and ties depend on.
pub(crate) struct ScatteredPose<'a, F, P> {
    pub transforms: &'a [Transform],
    pub center: DVec3,
    /// Returns the frame of a node.
    pub frame: F,
    /// Returns where a node is, in solving coordinates around the centre.
    pub at: P,
}

impl HandleSystem {
    /// The equations of a pose (`transforms[k]` belongs to hold k), for those who want to solve or store them
    /// themselves. Rigid regions that nothing holds are taken as free, as in the first of their two solves.
    pub fn equations(&self, body: &DeformableBody, transforms: &[Transform], pool: &Pool) -> SecondPassEquations {
        let frames = blend_frames_with(body, self, transforms, None, pool);
        let posed = self.pose_handles(body, transforms, frames, Precision::Double, pool);
        let mut rhs = vec![0.0; body.nodes() * 3];
        self.assemble(body, &posed, &mut rhs, pool);
        let at_rest = |node: usize| posed.targets[node] - posed.center;
        self.scatter(body, &posed, transforms, at_rest, &mut rhs);
        SecondPassEquations {
            rhs: rhs.as_chunks().0.to_vec(),
            given: posed.targets.iter().map(|p| (*p - posed.center).to_array()).collect(),
            frames: posed.frames,
            center: posed.center.to_array(),
        }
    }

    /// A pose with these frames.
    pub(crate) fn pose_handles(
        &self,
        body: &DeformableBody,
        transforms: &[Transform],
        frames: Vec<LocalFrame>,
        precision: Precision,
        pool: &Pool,
    ) -> PosedHandles {
        let targets = self.given_targets(body, transforms, pool);
        let center = mean_of(&targets, self.given());
        PosedHandles {
            frames,
            targets,
            center,
            precision,
        }
    }

    /// Fills `rhs` on the nodes that are not given, three numbers each, but for what [`HandleSystem::scatter`] adds.
    pub(crate) fn assemble(&self, body: &DeformableBody, posed: &PosedHandles, rhs: &mut [f64], pool: &Pool) {
        let given = self.given();
        match posed.precision {
            Precision::Single => fill_right_hand_side(body, &posed.frames, given, rhs, pool),
            Precision::Double => pool.install(|| {
                let rows = rhs.par_chunks_exact_mut(3).with_min_len(1024).enumerate();
                rows.filter(|(i, _)| !given[*i])
                    .for_each(|(i, rhs)| rhs.copy_from_slice(&right_hand_side(body, &posed.frames, i).to_array()));
            }),
        }
    }

    /// Adds to `rhs` what [`HandleSystem::add_scattered`] does; `at` returns where a node is, around the centre.
    pub(crate) fn scatter(
        &self,
        body: &DeformableBody,
        posed: &PosedHandles,
        transforms: &[Transform],
        at: impl Fn(usize) -> DVec3,
        rhs: &mut [f64],
    ) {
        let pose = ScatteredPose {
            transforms,
            center: posed.center,
            frame: |node: usize| linear(&posed.frames[node]),
            at,
        };
        self.add_scattered(body, &pose, &mut |node: usize, by: DVec3| {
            let entries = rhs[3 * node..3 * node + 3].iter_mut().zip(by.to_array());
            entries.for_each(|(r, b)| *r += b);
        });
    }

    /// What is added to right-hand sides at some nodes that are not given: offsets of ties, and pulls of soft handles around
    /// the centre.
    pub(crate) fn add_scattered<F: Fn(usize) -> DMat3, P: Fn(usize) -> DVec3>(
        &self,
        body: &DeformableBody,
        pose: &ScatteredPose<'_, F, P>,
        add: &mut dyn FnMut(usize, DVec3),
    ) {
        let ScatteredPose {
            transforms,
            center,
            frame,
            at,
        } = pose;
        let (center, given) = (*center, self.given());
        let mut add = |node: usize, by: DVec3| {
            if !given[node] {
                add(node, by);
            }
        };
        add_tie_offsets(body, frame, &mut add);
        if self.position.soft.is_empty() {
            return;
        }
        let maps: Vec<_> = transforms.iter().map(Transform::map).collect();
        for (pull, &(node, k, stiffness)) in self.position.soft.iter().enumerate() {
            let node = node as usize;
            if self.places.has_points(k) {
                add(node, at(node) * stiffness);
                continue;
            }
            let rest = body.graph.positions[node];
            let target = match (self.places.of_pull(pull, k), maps.get(k as usize)) {
                (Some(place), _) => place,
                (None, Some(map)) => map(rest),
                (None, None) => rest,
            };
            add(node, (body.solving_from_model(target) - center) * stiffness);
        }
        for point in self.places.points() {
            let way = body.solving_from_model(point.place) - center - point.now(at);
            let lack = point.lack(way) * point.weight;
            let corners = point.nodes.iter().zip(point.corners);
            corners.for_each(|(&node, weight)| add(node as usize, lack * weight));
        }
    }

    /// Whether [`HandleSystem::add_scattered`] adds anything.
    pub(crate) fn has_scattered(&self, body: &DeformableBody) -> bool {
        !self.position.soft.is_empty() || body.graph.ties.iter().any(|ties| !ties.anchors().is_empty())
    }

    /// Solving coordinates of all given nodes; rest elsewhere.
    fn given_targets(&self, body: &DeformableBody, transforms: &[Transform], pool: &Pool) -> Vec<DVec3> {
        let maps: Vec<_> = transforms.iter().map(|t| (!t.is_identity()).then(|| t.map())).collect();
        let target = |(node, &hold): (usize, &u32)| match maps.get(hold as usize) {
            Some(Some(map)) if hold != UNHELD => body.solving_from_model(map(body.graph.positions[node])),
            _ => body.rest(node),
        };
        let nodes = self.position.hard.par_iter().enumerate().with_min_len(4096);
        pool.install(|| nodes.map(target).collect())
    }
}

/// Equation (8)'s right-hand side at one node.
fn right_hand_side(body: &DeformableBody, frames: &[LocalFrame], i: usize) -> DVec3 {
    let here = body.rest(i);
    let (mut laplacian, mut others) = (DVec3::ZERO, DVec3::ZERO);
    for (j, w) in body.edges(i) {
        let edge = here - body.rest(j);
        laplacian += w * edge;
        others += linear(&frames[j]) * edge * w;
    }
    0.5 * (linear(&frames[i]) * laplacian + others)
}

/// Has ties keep the offset of a vertex from the flat triangle that it is tied to.
///
/// The edges of a tie to the corners of a large triangle would each follow the bend between their ends, and take the vertex
/// off the triangle, which stays flat: by as much as an arc stands off its chord. So all edges of a tie are shifted alike,
/// until together they ask for the turned offset. For triangles that are small against the bend this is next to nothing.
fn add_tie_offsets(body: &DeformableBody, frame: impl Fn(usize) -> DMat3, add: &mut dyn FnMut(usize, DVec3)) {
    let Some(ties) = &body.graph.ties else { return };
    let rest = |v: u32| body.rest(v as usize);
    let mut add = |v: u32, by: DVec3| add(v as usize, by);
    let frame_of = frame;
    for anchor in ties.anchors() {
        let own = frame_of(anchor.vertex as usize);
        let (mut offset, mut follows, mut turn, mut sum) = (DVec3::ZERO, DVec3::ZERO, DMat3::ZERO, 0.0);
        for (corner, weight) in anchor.weighted_corners() {
            let weight = f64::from(weight);
            let frame = frame_of(corner as usize);
            let edge = rest(anchor.vertex) - rest(corner);
            offset += edge * weight;
            follows += (own + frame) * edge * (0.5 * weight);
            turn += frame * weight;
            sum += weight;
        }
        // What is missing of the turned offset, for one unit of weight.
        let shift = ((turn * (0.5 / sum) + own * 0.5) * offset - follows) / sum;
        add(anchor.vertex, shift * sum);
        anchor
            .weighted_corners()
            .for_each(|(corner, weight)| add(corner, -shift * f64::from(weight)));
    }
}

fn linear(frame: &LocalFrame) -> DMat3 {
    if *frame == IDENTITY_FRAME {
        DMat3::IDENTITY
    } else {
        Mat3::from_cols_array(frame).as_dmat3()
    }
}

/// Mean of the values on given nodes, in a fixed order; the origin when nothing is given.
fn mean_of(values: &[DVec3], given: &[bool]) -> DVec3 {
    let (sum, count) = values
        .iter()
        .zip(given)
        .filter(|(_, given)| **given)
        .fold((DVec3::ZERO, 0usize), |(sum, count), (v, _)| (sum + *v, count + 1));
    if count == 0 { DVec3::ZERO } else { sum / count as f64 }
}
