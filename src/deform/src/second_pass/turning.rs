//! Handles whose rotation is not given: their place is, and the turn is found that leaves the least energy.
//!
//! The energy of a pose is Σ w |x_i − x_j − ½ (M_i + M_j)(p_i − p_j)|² over edges, with positions solved for. A handle's turn
//! moves its own nodes about its pivot, and turns every node's M by the node's share of it. What the energy loses by that is a
//! torque, and the turn is right where it is zero: a bar whose end is dragged aside then bends as an arc. Each torque costs one solve
//! from the last solution; steps come of the differences of earlier ones (Anderson 1965), so that a few suffice. Frames of a drag
//! begin where the last ones lead, and most of them need no solve but their own.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::handles::system::HandleSystem;
use crate::pose::{FirstPass, FitOrder, PoseRequest, Quality, SolutionExtent, SolveStart, SolvedNodes};
use crate::rotation::Transform;
use crate::second_pass::state::SolveState;
use crate::shares::map_with_scratch;
use glam::{DMat3, DVec3, Mat3};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Solves at most where a pose is solved from nothing, and for one frame of a drag.
const MOST_SOLVES: usize = 24;
const MOST_SOLVES_OF_DRAG: usize = 2;
/// Steps shorter than this, radians, are not worth another solve, likewise. A drag takes them with its next frame.
const NEAR_ENOUGH: f64 = 2e-4;
const NEAR_ENOUGH_OF_DRAG: f64 = 1e-2;
/// They are short enough only where they would be no longer than this, radians, if the directions of which nothing is known gave way as
/// far as anything does.
const MOST_DOUBT: f64 = 1e-2;
/// Nodes that one piece of work handles.
const PIECE: usize = 4096;

impl HandleSystem {
    /// The transforms of a pose with the rotations found of those holds that `free` names; the rotations of `request` are where the
    /// search begins, and where it goes on in a warm solve those of the solve before. As many solves as steps; a warm one leaves `state`
    /// with the last of them, which is the pose's own where `request` asks for no more than that.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`]. `state` stays usable after either.
    pub fn find_turns(
        &self,
        body: &DeformableBody,
        request: &PoseRequest<'_>,
        free: &[usize],
        state: &mut SolveState,
        exec: &Exec<'_>,
    ) -> Result<(Vec<Transform>, Option<SolvedNodes>), Error> {
        let mut transforms = request.transforms.to_vec();
        let warm = request.start == SolveStart::Warm;
        let free: Vec<usize> = free.iter().copied().filter(|&k| self.is_turnable(k)).collect();
        if free.is_empty() || !self.moved_parts(body, &transforms).contains(&true) {
            return Ok((transforms, None));
        }
        // A pose that is solved from nothing does not depend on what was solved before it.
        let mut own = SolveState::default();
        let state = if warm { state } else { &mut own };
        state.turning.begin(&free);
        let rotations = |of: &[Transform]| -> Vec<DVec3> { free.iter().map(|&k| of[k].rotation).collect() };
        if warm && state.transforms.len() == transforms.len() {
            let turns = state.turning.begin_from(rotations(&state.transforms));
            free.iter()
                .zip(turns)
                .for_each(|(&k, turn)| transforms[k].rotation = turn);
        }
        let (most, near) = match warm {
            true => (MOST_SOLVES_OF_DRAG, NEAR_ENOUGH_OF_DRAG),
            false => (MOST_SOLVES, NEAR_ENOUGH),
        };
        let mut last: Option<(Vec<DVec3>, Vec<DVec3>)> = None;
        for count in 1..=most {
            let start = if warm || count > 1 {
                SolveStart::Warm
            } else {
                SolveStart::Fresh
            };
            let search = search_request(&transforms, request, start);
            let solved = self.solve(body, &search, state, exec, &mut |_| true)?;
            let torque = self.torques(body, &transforms, &solved, &free, exec.pool);
            if let Some((step, before)) = last.take() {
                state.turning.remember(step, &before, &torque);
            }
            let (step, at_most) = state.turning.step(&torque);
            let longest = step.iter().map(|s| s.length()).fold(0.0, f64::max);
            if !longest.is_finite() {
                return Err(Error::Solver("a turn left the range of numbers".into()));
            }
            let is_last = count == most || (longest < near && at_most < MOST_DOUBT);
            if is_last && warm {
                state.turning.leave_ahead(rotations(&transforms), step);
                return Ok((transforms, (request.steps() == 0).then_some(solved)));
            }
            state.recycle(solved.positions, solved.frames);
            for (&k, step) in free.iter().zip(&step) {
                transforms[k].rotation += *step;
            }
            if is_last {
                break;
            }
            last = Some((step, torque));
        }
        Ok((transforms, None))
    }

    /// Whether a turn of a hold changes anything but all of it alike.
    fn is_turnable(&self, hold: usize) -> bool {
        self.rotation_fields.has_say(hold)
    }

    /// By free hold: the torque on it, as the turn that would end it if nothing around gave way.
    fn torques(
        &self,
        body: &DeformableBody,
        transforms: &[Transform],
        solved: &SolvedNodes,
        free: &[usize],
        pool: &Pool,
    ) -> Vec<DVec3> {
        if solved.frames.len() != body.nodes() {
            return vec![DVec3::ZERO; free.len()];
        }
        let fields = self.blending_fields.as_ref().unwrap_or(&self.rotation_fields);
        let search = TorqueSearch {
            handles: self,
            posed: EdgeEnds { body, solved },
            transforms,
        };
        let Some(shares) = fields.sparse() else {
            let pieces = body.nodes().div_ceil(PIECE);
            let of_hold = |&hold: &usize| {
                let of_piece = |piece: usize| {
                    let nodes = piece * PIECE..((piece + 1) * PIECE).min(body.nodes());
                    search.sum_over(hold, fields.of(hold), nodes, |node, other| other < node)
                };
                // Pieces are summed in their order, for any number of threads.
                let sums: Vec<(DVec3, f64)> = pool.install(|| (0..pieces).into_par_iter().map(of_piece).collect());
                let sum = sums
                    .into_iter()
                    .fold((DVec3::ZERO, 0.0), |(t, r), (torque, by)| (t + torque, r + by));
                search.turn(hold, sum)
            };
            return free.iter().map(of_hold).collect();
        };
        let mut is_free = vec![false; fields.holds()];
        free.iter().for_each(|&k| is_free[k] = true);
        let lists = shares.by_hold(fields.holds(), |k| is_free[k]);
        let scratch = || vec![0.0f32; body.nodes()];
        map_with_scratch(free.len(), pool, scratch, |field, k| {
            let own = &lists[free[k]];
            own.iter().for_each(|&(node, u)| field[node as usize] = u);
            let nodes = own.iter().map(|s| s.0 as usize);
            // An edge counts where it is met first, or where its other end has no say.
            let is_counted = |node: usize, other: usize| other < node || field[other] == 0.0;
            let sum = search.sum_over(free[k], field, nodes, is_counted);
            own.iter().for_each(|&(node, _)| field[node as usize] = 0.0);
            search.turn(free[k], sum)
        })
    }
}

/// What torques on holds are found from.
struct TorqueSearch<'a> {
    handles: &'a HandleSystem,
    posed: EdgeEnds<'a>,
    transforms: &'a [Transform],
}

impl TorqueSearch<'_> {
    /// Where a hold turns about, solving coordinates.
    fn place(&self, hold: usize) -> DVec3 {
        let transform = &self.transforms[hold];
        self.posed
            .body
            .solving_from_model(transform.pivot + transform.translation)
    }

    /// The torque on a hold with this field, and what resists it, of the edges of `nodes` that `is_counted` accepts.
    fn sum_over(
        &self,
        hold: usize,
        field: &[f32],
        nodes: impl Iterator<Item = usize>,
        is_counted: impl Fn(usize, usize) -> bool,
    ) -> (DVec3, f64) {
        let place = self.place(hold);
        let is_held = |node: usize| self.handles.position.hard[node] == hold as u32;
        let mut sum = (DVec3::ZERO, 0.0);
        for node in nodes {
            let here = self.posed.node(node);
            for (other, weight) in self
                .posed
                .body
                .edges(node)
                .filter(|(other, _)| is_counted(node, *other))
            {
                let shares = [node, other].map(|end| f64::from(field[end]));
                let held = [node, other].map(is_held);
                if shares == [0.0; 2] && held[0] == held[1] {
                    continue;
                }
                let ends = [&here, &self.posed.node(other)];
                let edge = here.rest - ends[1].rest;
                // The edge as the frame of each end would have it, and what it lacks of their mean.
                let own = ends.map(|end| end.frame * edge);
                let missing = here.at - ends[1].at - (own[0] + own[1]) * 0.5;
                for (own, share) in own.into_iter().zip(shares) {
                    sum.0 -= own.cross(missing) * (0.5 * weight * share);
                    sum.1 += 0.25 * weight * own.length_squared() * share * share;
                }
                if held[0] != held[1] {
                    let arm = ends[usize::from(held[1])].at - place;
                    sum.0 += arm.cross(missing) * if held[0] { weight } else { -weight };
                    sum.1 += weight * arm.length_squared();
                }
            }
        }
        sum
    }

    /// The turn that ends a torque, with what soft pulls add to it, where nothing around gives way.
    fn turn(&self, hold: usize, (mut torque, resistance): (DVec3, f64)) -> DVec3 {
        let (body, place) = (self.posed.body, self.place(hold));
        let map = self.transforms[hold].map();
        for &(node, _, stiffness) in self.handles.position.soft.iter().filter(|pull| pull.1 == hold as u32) {
            let target = body.solving_from_model(map(body.graph.positions[node as usize]));
            let arm = target - place;
            // It resists less than this: what it pulls turns along.
            torque += arm.cross(target - self.posed.at(node as usize)) * stiffness;
        }
        if resistance > 0.0 {
            torque / resistance
        } else {
            DVec3::ZERO
        }
    }
}

/// A request for the shape that a torque is taken from.
fn search_request<'a>(transforms: &'a [Transform], wanted: &PoseRequest<'_>, start: SolveStart) -> PoseRequest<'a> {
    PoseRequest {
        transforms,
        quality: Quality {
            refine: Some(0),
            ..wanted.quality
        },
        start,
        first_pass: FirstPass::Harmonic,
        fits: FitOrder::GraphAlone,
        extent: SolutionExtent::Graph,
        smooth_borders: false,
    }
}

/// The nodes of a solution, in solving coordinates.
struct EdgeEnds<'a> {
    body: &'a DeformableBody,
    solved: &'a SolvedNodes,
}

struct EdgeEnd {
    rest: DVec3,
    at: DVec3,
    frame: DMat3,
}

impl EdgeEnds<'_> {
    fn at(&self, node: usize) -> DVec3 {
        self.body.solving_from_model(self.solved.positions[node])
    }

    fn node(&self, node: usize) -> EdgeEnd {
        EdgeEnd {
            rest: self.body.rest(node),
            at: self.at(node),
            frame: Mat3::from_cols_array(&self.solved.frames[node]).as_dmat3(),
        }
    }
}
