//! A solved pose solved once more, with rotations that change less from node to node where that is asked for.
//!
//! A fit follows every wrinkle of the shape that it is fitted to, and may make it deeper where a surface is squeezed. What fits
//! have added to the first pass's rotations is smoothed instead: with weight 1 it becomes harmonic there, as the first pass's own
//! fields are, with less it is a mean of that and of what was fitted, and with weight 0 everywhere else it stays. With weight 1 at
//! all nodes nothing is left of the fits, and the pose is that of the paper's two passes.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::first_pass::blend::LocalRotation;
use crate::first_pass::spread::FirstRotations;
use crate::handles::system::HandleSystem;
use crate::pose::{PoseRequest, SolvedNodes};
use crate::second_pass::equations::Precision;
use crate::second_pass::refine::RotationFit;
use crate::second_pass::state::SolveState;
use crate::solve::{PoseSolve, SolveTally, prepare};
use glam::Quat;
use pliant_exec::Exec;
use pliant_solver::InitialGuess;

/// Relative residual to which rotations are smoothed.
const SMOOTH_ENOUGH: f64 = 1e-3;
/// Steps of conjugate gradients at most.
const MOST_STEPS: usize = 200;
/// Smaller weights count as none.
const LEAST_WEIGHT: f32 = 1e-3;

/// What is done to the rotations of a solved pose before it is solved again.
#[derive(Debug, Clone, Copy)]
pub struct TurnChange<'a> {
    /// What is done.
    pub kind: TurnChangeKind,
    /// By node what was added to the first pass's rotations ([`SolveState::added_turns`]).
    pub turns: &'a [LocalRotation],
    /// By node where that is changed and how far, 0 to 1.
    pub weights: &'a [f32],
}

/// A kind of change of rotations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TurnChangeKind {
    /// What fits have added to them is smoothed, as far as the weights say.
    Smooth,
    /// They are fitted once more where weights are not 0, this far: 1 is to the rotation that fits best.
    FitPartly(f32),
}

impl HandleSystem {
    /// Solves a pose again that `state` has a solution of, with other rotations. Also returns what is added to the first pass's
    /// rotations now.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`]. `state` stays usable after either.
    pub fn solve_changed(
        &self,
        body: &DeformableBody,
        request: &PoseRequest<'_>,
        change: &TurnChange<'_>,
        state: &mut SolveState,
        exec: &Exec<'_>,
    ) -> Result<(SolvedNodes, Vec<LocalRotation>), Error> {
        let moved_parts = self.moved_parts(body, request.transforms);
        let pose = PoseSolve {
            handles: self,
            body,
            request,
            moved_parts: &moved_parts,
            exec,
        };
        let first = FirstRotations::of(body, self, request, exec.pool);
        let mut fit = RotationFit::new(body, self, request, &moved_parts, &first);
        fit.remember_first(exec.pool);
        let TurnChange { kind, turns, weights } = *change;
        let is_open = |node: usize| fit.is_open(node) && weights[node] >= LEAST_WEIGHT;
        let added = match kind {
            TurnChangeKind::Smooth => smoothed(body, turns, weights, is_open),
            TurnChangeKind::FitPartly(reach) => {
                let before = fit.resume(turns, exec.pool);
                let after = fit.step_where(is_open, &before, &state.x, exec.pool);
                let between = |node: usize| match is_open(node) {
                    true => part_way(before[node], after[node], reach),
                    false => before[node],
                };
                fit.extra(&exec.pool.map(body.nodes(), 1024, between), exec.pool)
            }
        };
        let mut frames = fit.frames(&fit.resume(&added, exec.pool), exec.pool);
        (state.volume).apply(&self.rotation_fields, &mut frames, exec.pool, |node| fit.is_open(node));
        let mut posed = self.pose_handles(body, request.transforms, frames, Precision::Double, exec.pool);
        let mut tally = SolveTally {
            iterations: 0,
            refined: request.steps(),
            center: posed.center,
            watch: &mut |_| true,
            stopped: false,
        };
        prepare(body, self, &posed, true, state, exec.pool);
        pose.assemble(&mut posed, state);
        let stats = pose.run(&self.positions, InitialGuess::Given, 0.0, state, &mut tally)?;
        if !self.stiff.is_empty() {
            pose.stiffen(None, &mut posed, state)?;
        }
        let solved = pose.finish(stats, &mut posed, state, &mut tally)?;
        let frames = posed.frames;
        Ok((SolvedNodes { frames, ..solved }, added))
    }
}

/// From one rotation part of the way to another.
fn part_way(from: LocalRotation, to: LocalRotation, reach: f32) -> LocalRotation {
    let (from, to) = (Quat::from_array(from), Quat::from_array(to));
    let to = if to.dot(from) < 0.0 { -to } else { to };
    (from * (1.0 - reach) + to * reach).normalize().to_array()
}

/// Rotations smoothed on the nodes that are open, by the weights; the others stay.
fn smoothed(
    body: &DeformableBody,
    turns: &[LocalRotation],
    weights: &[f32],
    is_open: impl Fn(usize) -> bool,
) -> Vec<LocalRotation> {
    // Both signs are the same rotation: the one nearer to none.
    let mut all: Vec<LocalRotation> = turns
        .iter()
        .map(|q| if q[3] < 0.0 { q.map(|v| -v) } else { *q })
        .collect();
    let nodes: Vec<usize> = (0..all.len()).filter(|&node| is_open(node)).collect();
    let mut place = vec![u32::MAX; all.len()];
    nodes.iter().zip(0u32..).for_each(|(&node, k)| place[node] = k);
    let mut system = SmoothingRows::default();
    for &node in &nodes {
        let own = f64::from(weights[node].min(1.0));
        let (mut sum, mut given) = (0.0, [0.0; 4]);
        for (other, w) in body.edges(node) {
            sum += w;
            match place[other] {
                u32::MAX => (0..4).for_each(|c| given[c] += w * f64::from(all[other][c])),
                k => system.entries.push((k, w as f32)),
            }
        }
        let keep = sum * (1.0 - own) / own;
        (0..4).for_each(|c| given[c] += keep * f64::from(all[node][c]));
        system.first.push(system.entries.len());
        system.diagonal.push((sum + keep).max(f64::MIN_POSITIVE));
        system.given.push(given);
    }
    let mut x: Vec<[f64; 4]> = nodes.iter().map(|&node| all[node].map(f64::from)).collect();
    system.solve(&mut x);
    for (&node, q) in nodes.iter().zip(&x) {
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        if length > 1e-6 {
            all[node] = q.map(|v| (v / length) as f32);
        }
    }
    all
}

/// Equations of rotations that are smoothed, four numbers each.
#[derive(Default)]
struct SmoothingRows {
    /// Where the entries of each row end.
    first: Vec<usize>,
    /// Weights of edges have single precision.
    entries: Vec<(u32, f32)>,
    diagonal: Vec<f64>,
    given: Vec<[f64; 4]>,
}

impl SmoothingRows {
    fn times(&self, x: &[[f64; 4]], out: &mut [[f64; 4]]) {
        let mut begin = 0;
        for (row, out) in out.iter_mut().enumerate() {
            let mut sum = x[row].map(|v| v * self.diagonal[row]);
            for &(k, w) in &self.entries[begin..self.first[row]] {
                (0..4).for_each(|c| sum[c] -= f64::from(w) * x[k as usize][c]);
            }
            begin = self.first[row];
            *out = sum;
        }
    }

    /// Conjugate gradients, preconditioned by the diagonal, in the order of the rows.
    fn solve(mut self, x: &mut [[f64; 4]]) {
        let dot = |a: &[[f64; 4]], b: &[[f64; 4]]| -> f64 {
            a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
        };
        // The product of a residual with the preconditioned one, which is nowhere kept.
        let preconditioned = |r: &[[f64; 4]]| -> f64 {
            let rows = r.iter().zip(&self.diagonal);
            rows.flat_map(|(r, d)| r.map(|v| v * (v / d))).sum()
        };
        let mut product = vec![[0.0; 4]; x.len()];
        self.times(x, &mut product);
        let mut r = std::mem::take(&mut self.given);
        for (r, a) in r.iter_mut().zip(&product) {
            (0..4).for_each(|c| r[c] -= a[c]);
        }
        let mut p: Vec<[f64; 4]> = r.iter().zip(&self.diagonal).map(|(r, d)| r.map(|v| v / d)).collect();
        let mut rz = preconditioned(&r);
        let enough = SMOOTH_ENOUGH * SMOOTH_ENOUGH * rz;
        for _ in 0..MOST_STEPS {
            if rz <= enough || rz <= 0.0 {
                return;
            }
            self.times(&p, &mut product);
            let step = rz / dot(&p, &product);
            for (((x, r), p), a) in x.iter_mut().zip(&mut r).zip(&p).zip(&product) {
                (0..4).for_each(|c| {
                    x[c] += step * p[c];
                    r[c] -= step * a[c];
                });
            }
            let next = preconditioned(&r);
            let share = next / rz;
            rz = next;
            for ((p, r), d) in p.iter_mut().zip(&r).zip(&self.diagonal) {
                (0..4).for_each(|c| p[c] = r[c] / d + share * p[c]);
            }
        }
    }
}
