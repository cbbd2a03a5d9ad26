//! Fitting every node's rotation to the shape that the last solve gave it.
//!
//! The second pass is the global step of as-rigid-as-possible energy (Sorkine & Alexa 2007): with positions held, the
//! best rotation of a node is the rotational part of Σ w (x_i − x_j)(S_i (p_i − p_j))ᵀ, and with rotations held, the best
//! positions solve equation (8). Alternating the two on one hierarchy makes rotations follow what handles do by being
//! moved, to which the first pass is blind. Smoothing adds each node's neighbours' rotations to its own fit (Levi &
//! Gotsman 2015).

use crate::body::DeformableBody;
use crate::first_pass::blend::{
    IDENTITY_FRAME, LocalFrame, LocalRotation, PoseBlend, pack_frame, pack_rotation, unpack_rotation,
};
use crate::first_pass::spread::FirstRotations;
use crate::handles::ownership::UNHELD;
use crate::handles::system::HandleSystem;
use crate::pose::{FitOrder, PoseRequest, Quality};
use crate::rotation::Transform;
use crate::second_pass::single_precision::QuickFit;
use glam::{DMat3, DQuat, DVec3, Mat3};
use pliant_exec::pool::Pool;
use pliant_mesh::rotation::{exp_rotation, nearest_rotation};

/// How far a carried fit goes, where 1 is to the rotation that fits best: successive over-relaxation of the alternation, which
/// creeps towards its minimum.
const FARTHER: f64 = 1.6;

/// Fits the rotations of one pose.
pub(crate) struct RotationFit<'a> {
    body: &'a DeformableBody,
    handles: &'a HandleSystem,
    blend: PoseBlend<'a>,
    /// Rotations of the holds.
    holds: Vec<DQuat>,
    /// By component: whether any handle that moved has a say in it.
    moved_parts: &'a [bool],
    /// What neighbours weigh in a fit.
    smoothing: f64,
    is_carried: bool,
    /// The pull of soft handles on rotations: where each node's begin in the list.
    soft: Vec<u32>,
    /// Whether there are neither scales nor soft rotations nor smoothing.
    is_plain: bool,
    /// In single precision, where the first pass is one for animations.
    quick: Option<QuickFit<'a>>,
    /// The first pass's rotations by node, where they are asked for again and again.
    remembered: Vec<DQuat>,
}

impl<'a> RotationFit<'a> {
    pub fn new(
        body: &'a DeformableBody,
        handles: &'a HandleSystem,
        request: &PoseRequest<'_>,
        moved_parts: &'a [bool],
        first: &'a FirstRotations<'_>,
    ) -> Self {
        let (transforms, smoothing) = (request.transforms, request.quality.smoothing);
        let is_carried = request.fits == FitOrder::Carried;
        let instead = first.instead.as_deref();
        let soft = handles.rotation.first_pulls();
        let blend = PoseBlend::new(body, handles, transforms, instead);
        let is_plain = blend.is_unscaled() && soft.is_empty() && smoothing == 0.0;
        let reach = if is_carried { FARTHER } else { 1.0 };
        let quick = instead.filter(|_| is_plain && first.is_animation);
        let quick = quick.map(|first| QuickFit {
            body,
            first,
            reach: reach as f32,
        });
        Self {
            is_plain,
            quick,
            remembered: Vec::new(),
            body,
            handles,
            blend,
            holds: transforms.iter().map(|t| exp_rotation(t.rotation)).collect(),
            moved_parts,
            smoothing,
            is_carried,
            soft,
        }
    }

    /// Whether fits depend on positions alone: there are neither scales nor soft rotations nor smoothing.
    pub fn is_plain(&self) -> bool {
        self.is_plain && !self.is_carried
    }

    /// Whether a node's rotation is open: it is in a part that moves, and no handle says how it is turned.
    pub fn is_open(&self, node: usize) -> bool {
        self.moved_parts[self.body.graph.component[node] as usize] && self.handles.rotation.hard[node] == UNHELD
    }

    /// Keeps the first pass's rotations at hand.
    pub fn remember_first(&mut self, pool: &Pool) {
        self.remembered = self.each(pool, |i| self.first(i));
    }

    fn first(&self, node: usize) -> DQuat {
        match self.remembered.get(node) {
            Some(first) => *first,
            None => self.blend.rotation(node).unwrap_or(DQuat::IDENTITY),
        }
    }

    /// The first pass's rotations.
    pub fn start(&self, pool: &Pool) -> Vec<LocalRotation> {
        if let Some(quick) = &self.quick {
            return quick.first.to_vec();
        }
        self.each(pool, |i| pack_rotation(self.first(i)))
    }

    /// The first pass's rotations, turned by what refinement had added to them in the pose before (`extra`).
    pub fn resume(&self, extra: &[LocalRotation], pool: &Pool) -> Vec<LocalRotation> {
        if let Some(quick) = &self.quick {
            return quick.resume(extra, |i| self.is_open(i), pool);
        }
        self.each(pool, |i| match self.is_open(i) {
            true => pack_rotation(unpack_rotation(extra[i]) * self.first(i)),
            false => pack_rotation(self.first(i)),
        })
    }

    /// What refinement has added to the first pass's rotations.
    pub fn extra(&self, turns: &[LocalRotation], pool: &Pool) -> Vec<LocalRotation> {
        if let Some(quick) = &self.quick {
            return quick.extra(turns, pool);
        }
        self.each(pool, |i| {
            pack_rotation(unpack_rotation(turns[i]) * self.first(i).inverse())
        })
    }

    /// Frames with these rotations and the first pass's scales.
    pub fn frames(&self, turns: &[LocalRotation], pool: &Pool) -> Vec<LocalFrame> {
        if let Some(quick) = &self.quick {
            return quick.frames(turns, pool);
        }
        self.each(pool, |i| match (self.blend.scale(i), self.is_open(i)) {
            (None, false) if turns[i] == [0.0, 0.0, 0.0, 1.0] => IDENTITY_FRAME,
            (scale, _) => pack_frame(unpack_rotation(turns[i]), scale),
        })
    }

    /// What the volume around a node is to be of the one in the rest pose: that of the handles' scales.
    pub fn wanted_volume(&self, node: usize) -> f64 {
        self.blend.scale(node).map_or(1.0, |scale| scale.determinant())
    }

    /// One fit of all open nodes to `x` (solving coordinates, three numbers a node, any origin).
    pub fn step(&self, turns: &[LocalRotation], x: &[f64], pool: &Pool) -> Vec<LocalRotation> {
        self.step_where(|i| self.is_open(i), turns, x, pool)
    }

    /// The same of some nodes, all of them open.
    pub fn step_where(
        &self,
        is_fitted: impl Fn(usize) -> bool + Sync + Send,
        turns: &[LocalRotation],
        x: &[f64],
        pool: &Pool,
    ) -> Vec<LocalRotation> {
        if let Some(quick) = &self.quick {
            return quick.step(turns, x, is_fitted, pool);
        }
        self.each(pool, |i| match is_fitted(i) {
            true if self.is_carried => pack_rotation(farther(unpack_rotation(turns[i]), self.fitted(i, turns, x))),
            true => pack_rotation(self.fitted(i, turns, x)),
            false => turns[i],
        })
    }

    fn fitted(&self, i: usize, turns: &[LocalRotation], x: &[f64]) -> DQuat {
        let body = self.body;
        let at = |j: usize| DVec3::new(x[3 * j], x[3 * j + 1], x[3 * j + 2]);
        let (here, rest) = (at(i), body.rest(i));
        let (mut sum, mut size, mut weights) = (DMat3::ZERO, 0.0, 0.0);
        let mut around = DMat3::ZERO;
        for (j, w) in body.edges(i) {
            let (edge, now) = (rest - body.rest(j), (here - at(j)) * w);
            sum += DMat3::from_cols(now * edge.x, now * edge.y, now * edge.z);
            size += w * edge.length_squared();
            weights += w;
            if self.smoothing > 0.0 {
                around += DMat3::from_quat(unpack_rotation(turns[j])) * w;
            }
        }
        if let Some(scale) = self.blend.scale(i) {
            // (x_i − x_j)(S e)ᵀ = (x_i − x_j) eᵀ S, S being symmetric.
            sum *= scale;
        }
        if weights > 0.0 {
            let unit = size / weights;
            sum += around * (self.smoothing * unit);
            if !self.soft.is_empty() {
                let pulls = self.soft[i] as usize..self.soft[i + 1] as usize;
                for &(_, k, stiffness) in &self.handles.rotation.soft[pulls] {
                    let held = self.holds.get(k as usize).copied().unwrap_or(DQuat::IDENTITY);
                    sum += DMat3::from_quat(held) * (stiffness * unit);
                }
            }
        }
        nearest_rotation(sum, unpack_rotation(turns[i]))
    }

    fn each<T: Send>(&self, pool: &Pool, value: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        pool.map(self.body.nodes(), 1024, value)
    }
}

/// From one rotation towards another and beyond it.
fn farther(from: DQuat, to: DQuat) -> DQuat {
    let to = if to.dot(from) < 0.0 { -to } else { to };
    (from * (1.0 - FARTHER) + to * FARTHER).normalize()
}

impl HandleSystem {
    /// The as-rigid-as-possible energy of node positions (model space): Σ w |x_i − x_j − M_i (p_i − p_j)|² over all edges, both ways,
    /// relative to Σ w |p_i − p_j|², with the rotations that make it least where no handle says them. Pulls of soft handles have no
    /// part in it.
    pub fn energy(&self, body: &DeformableBody, transforms: &[Transform], positions: &[DVec3], pool: &Pool) -> f64 {
        let moved_parts = self.moved_parts(body, transforms);
        let first = FirstRotations::BLEND;
        let request = PoseRequest::new(transforms, Quality::DEFAULT);
        let fit = RotationFit::new(body, self, &request, &moved_parts, &first);
        let x: Vec<f64> = positions
            .iter()
            .flat_map(|p| body.solving_from_model(*p).to_array())
            .collect();
        let frames = fit.frames(&fit.step(&fit.start(pool), &x, pool), pool);
        let at = |i: usize| DVec3::from_slice(&x[3 * i..3 * i + 3]);
        let rest = |i: usize| body.rest(i);
        let (mut sum, mut size) = (0.0, 0.0);
        for (i, frame) in frames.iter().enumerate() {
            let frame = Mat3::from_cols_array(frame).as_dmat3();
            for (j, w) in body.edges(i) {
                let edge = rest(i) - rest(j);
                sum += w * (at(i) - at(j) - frame * edge).length_squared();
                size += w * edge.length_squared();
            }
        }
        if size > 0.0 { sum / size } else { 0.0 }
    }
}
