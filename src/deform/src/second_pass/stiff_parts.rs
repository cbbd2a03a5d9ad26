//! Positions with parts that move as rigid bodies.
//!
//! A solve without them is where it begins: each part is put where it fits best. Then free nodes and parts move together: the
//! energy of edges, to second order in what nodes move by and what parts move and turn by, is made least by conjugate gradients.
//! Each step of those is preconditioned by a multigrid cycle of the whole graph, from which parts take their mean motion (a
//! fictitious space, Nepomnyaschikh 1991), so that a chain of a thousand parts takes about as many steps as one. An edge
//! within a part is never stretched and has no say; an edge that leaves one turns with it about its own middle.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::first_pass::blend::{LocalFrame, LocalRotation, pack_frame, pack_rotation};
use crate::handles::stiff::{PartPlace, StiffParts, Wrench};
use crate::handles::system::HandleSystem;
use crate::second_pass::equations::PosedHandles;
use crate::second_pass::refine::RotationFit;
use crate::second_pass::state::SolveState;
use crate::solve::PoseSolve;
use glam::{DMat3, DVec3, Mat3};
use pliant_exec::pool::Pool;
use pliant_exec::progress::check;
use pliant_mesh::rotation::exp_rotation;
use pliant_solver::{InitialGuess, SolveControl, SolveOptions, Workspace};

/// How often parts and free nodes move together, where rotations are fitted and where not.
const ROUNDS: usize = 3;
const ROUNDS_OF_DRAG: usize = 1;
/// Steps of one round at most.
const MOST_STEPS: usize = 24;
/// What a round leaves of the force that it began with, measured by the energy that it would set free.
const LEFT: f64 = 0.03;
/// The largest turn of a part in one round, radians.
const LARGEST_TURN: f64 = 0.5;

impl PoseSolve<'_> {
    /// Moves stiff parts and what is between them from the solution in `state.x` that takes no note of them. Leaves the parts' nodes
    /// and frames where they are to be, and all others near.
    pub(crate) fn stiffen(
        &self,
        fit: Option<&RotationFit<'_>>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
    ) -> Result<(), Error> {
        let (handles, body, pool) = (self.handles, self.body, self.exec.pool);
        let parts = &handles.stiff;
        let soft = soft_nodes(parts, &state.x);
        let mut places = parts.fit(body, &state.x, pool);
        let mut turns = fit.map(|fit| match state.extra.len() == body.nodes() {
            true => fit.resume(&state.extra, pool),
            false => fit.start(pool),
        });
        let scaled = |fit: &RotationFit<'_>, turns: &[LocalRotation], state: &SolveState| {
            let mut frames = fit.frames(turns, pool);
            (state.volume).apply(&handles.rotation_fields, &mut frames, pool, |node| fit.is_open(node));
            frames
        };
        let rounds = if turns.is_some() { ROUNDS } else { ROUNDS_OF_DRAG };
        let mut workspace = Workspace::default();
        for round in 0..rounds {
            check(self.exec.progress)?;
            if let (Some(fit), Some(turns)) = (fit, &mut turns) {
                if round > 0 {
                    *turns = fit.step(turns, &state.x, pool);
                }
                parts.turn(&places, turns);
                posed.frames = scaled(fit, turns, state);
            }
            parts.put(body, &places, &mut posed.frames, &mut state.x);
            self.assemble(posed, state);
            let together = MovingTogether {
                handles,
                body,
                parts,
                frames: &posed.frames,
                x: &state.x,
                places: &places,
                stiffness: handles.stiffness(),
                pool,
            };
            let motion = together.solve(&state.rhs, &mut workspace, self)?;
            motion.apply(&mut state.x, &mut places);
        }
        if let (Some(fit), Some(turns)) = (fit, &mut turns) {
            parts.turn(&places, turns);
            posed.frames = scaled(fit, turns, state);
            state.extra = fit.extra(turns, pool);
        }
        parts.put(body, &places, &mut posed.frames, &mut state.x);
        if parts.strength < 1.0 {
            for (&node, soft) in parts.all_nodes().iter().zip(soft) {
                let at = &mut state.x[3 * node as usize..3 * node as usize + 3];
                at.copy_from_slice(&soft.lerp(DVec3::from_slice(at), parts.strength).to_array());
            }
        }
        Ok(())
    }
}

/// Where the nodes of parts are that are not rigid throughout.
fn soft_nodes(parts: &StiffParts, x: &[f64]) -> Vec<DVec3> {
    let nodes = parts.all_nodes().iter().filter(|_| parts.strength < 1.0);
    nodes
        .map(|&n| DVec3::from_slice(&x[3 * n as usize..3 * n as usize + 3]))
        .collect()
}

impl StiffParts {
    /// Gives all nodes of parts the rotations of their parts.
    fn turn(&self, places: &[PartPlace], turns: &mut [LocalRotation]) {
        for (part, place) in places.iter().enumerate() {
            let turn = pack_rotation(place.turn);
            self.nodes_of(part).iter().for_each(|&n| turns[n as usize] = turn);
        }
    }

    /// Puts all nodes of parts in their places, with the frames of those.
    fn put(&self, body: &DeformableBody, places: &[PartPlace], frames: &mut [LocalFrame], x: &mut [f64]) {
        for (part, place) in places.iter().enumerate() {
            let frame = pack_frame(place.turn, None);
            for &n in self.nodes_of(part) {
                let n = n as usize;
                x[3 * n..3 * n + 3].copy_from_slice(&self.position(body, part, place, n).to_array());
                if let Some(own) = frames.get_mut(n) {
                    *own = frame;
                }
            }
        }
    }
}

/// Forces on free nodes and on parts, or motions of them. Nodes that are given, or of a part, have none of their own.
#[derive(Debug, Clone)]
struct Together {
    nodes: Vec<DVec3>,
    parts: Vec<Wrench>,
}

impl Together {
    fn dot(&self, other: &Self) -> f64 {
        let nodes: f64 = self.nodes.iter().zip(&other.nodes).map(|(a, b)| a.dot(*b)).sum();
        nodes + self.parts.iter().zip(&other.parts).map(|(a, b)| a.dot(b)).sum::<f64>()
    }

    fn add(&mut self, other: &Self, times: f64) {
        self.nodes
            .iter_mut()
            .zip(&other.nodes)
            .for_each(|(a, b)| *a += *b * times);
        self.parts
            .iter_mut()
            .zip(&other.parts)
            .for_each(|(a, b)| *a += *b * times);
    }

    /// Moves free nodes and parts.
    fn apply(&self, x: &mut [f64], places: &mut [PartPlace]) {
        let largest = self.parts.iter().map(|p| p.turn.length()).fold(0.0, f64::max);
        let share = if largest > LARGEST_TURN {
            LARGEST_TURN / largest
        } else {
            1.0
        };
        for (x, by) in x.as_chunks_mut::<3>().0.iter_mut().zip(&self.nodes) {
            *x = (DVec3::from_array(*x) + *by * share).to_array();
        }
        for (place, by) in places.iter_mut().zip(&self.parts) {
            place.center += by.straight * share;
            place.turn = (exp_rotation(by.turn * share) * place.turn).normalize();
        }
    }
}

/// Free nodes and parts about to move from where they are.
struct MovingTogether<'a> {
    handles: &'a HandleSystem,
    body: &'a DeformableBody,
    parts: &'a StiffParts,
    frames: &'a [LocalFrame],
    x: &'a [f64],
    places: &'a [PartPlace],
    stiffness: Option<Vec<f64>>,
    pool: &'a Pool,
}

impl MovingTogether<'_> {
    /// The motion that makes the energy least; `rhs` is the second pass's.
    fn solve(&self, rhs: &[f64], workspace: &mut Workspace, pose: &PoseSolve<'_>) -> Result<Together, Error> {
        let mut left = self.forces(rhs);
        let mut motion = Together {
            nodes: vec![DVec3::ZERO; left.nodes.len()],
            parts: vec![Wrench::default(); left.parts.len()],
        };
        let mut before: Option<(Together, Together, f64)> = None;
        let mut enough = 0.0;
        for step in 0..MOST_STEPS {
            check(pose.exec.progress)?;
            let mut along = self.preconditioned(&left, workspace, pose)?;
            let size = left.dot(&along);
            if step == 0 {
                enough = size * LEFT * LEFT;
            }
            if size <= enough || size.is_nan() {
                break;
            }
            if let Some((way, resisted, energy)) = &before {
                // A cycle is not quite linear, so that steps are made conjugate with what is there.
                let share = along.dot(resisted) / energy;
                along.add(way, -share);
            }
            let resisted = self.resistance(&along);
            let energy = along.dot(&resisted);
            if energy <= 0.0 || energy.is_nan() {
                break;
            }
            let far = left.dot(&along) / energy;
            motion.add(&along, far);
            left.add(&resisted, -far);
            before = Some((along, resisted, energy));
        }
        Ok(motion)
    }

    fn at(&self, node: usize) -> DVec3 {
        DVec3::from_slice(&self.x[3 * node..3 * node + 3])
    }

    fn frame(&self, node: usize) -> DMat3 {
        Mat3::from_cols_array(&self.frames[node]).as_dmat3()
    }

    fn is_alone(&self, node: usize) -> bool {
        !self.handles.positions.fixed[node] && self.parts.part(node).is_none()
    }

    /// What pulls at free nodes and parts.
    fn forces(&self, rhs: &[f64]) -> Together {
        let stiffness = |node: usize| self.stiffness.as_ref().map_or(0.0, |s| s[node]);
        let force = |node: usize| {
            let here = self.at(node);
            let pulls: DVec3 = self.body.edges(node).map(|(j, w)| (here - self.at(j)) * w).sum();
            DVec3::from_slice(&rhs[3 * node..3 * node + 3]) - pulls - here * stiffness(node)
        };
        let nodes = self
            .pool
            .map(self.body.nodes(), 1024, |node| match self.is_alone(node) {
                true => force(node),
                false => DVec3::ZERO,
            });
        let parts = self.pool.map(self.parts.count(), 1, |part| {
            let center = self.places[part].center;
            let mut sum = Wrench::default();
            for &node in self.parts.nodes_of(part) {
                let force = force(node as usize);
                sum += Wrench {
                    straight: force,
                    turn: (self.at(node as usize) - center).cross(force),
                };
            }
            // What is fitted to a node's edges alone, as where rotations are fitted: the frames of other ends may lag.
            for &(node, other, weight) in self.parts.border_of(part) {
                let (node, other) = (node as usize, other as usize);
                let own = self.frame(node) * (self.body.rest(node) - self.body.rest(other));
                let now = self.at(node) - self.at(other);
                sum.turn += own.cross(now) * (0.5 * f64::from(weight));
            }
            sum
        });
        Together { nodes, parts }
    }

    /// What a node moves by with `motion`, its end of an edge to `other` being taken where the edge turns with a part.
    fn moved(&self, motion: &Together, node: usize, other: Option<usize>) -> DVec3 {
        let Some(part) = self.parts.part(node) else {
            return motion.nodes[node];
        };
        let mut arm = self.at(node) - self.places[part].center;
        if let Some(other) = other {
            arm -= self.frame(node) * (self.body.rest(node) - self.body.rest(other)) * 0.5;
        }
        motion.parts[part].straight + motion.parts[part].turn.cross(arm)
    }

    /// The forces that a motion would give rise to, against it.
    fn resistance(&self, motion: &Together) -> Together {
        let stiffness = |node: usize| self.stiffness.as_ref().map_or(0.0, |s| s[node]);
        let nodes = self.pool.map(self.body.nodes(), 1024, |node| {
            if !self.is_alone(node) {
                return DVec3::ZERO;
            }
            let own = motion.nodes[node];
            let edges = self.body.edges(node);
            let pulls: DVec3 = edges.map(|(j, w)| (own - self.moved(motion, j, Some(node))) * w).sum();
            pulls + own * stiffness(node)
        });
        let parts = self.pool.map(self.parts.count(), 1, |part| {
            let center = self.places[part].center;
            let mut sum = Wrench::default();
            for &(node, other, weight) in self.parts.border_of(part) {
                let (node, other) = (node as usize, other as usize);
                let edge = self.frame(node) * (self.body.rest(node) - self.body.rest(other));
                let arm = self.at(node) - center - edge * 0.5;
                let far = self.moved(motion, node, Some(other)) - self.moved(motion, other, Some(node));
                let force = far * f64::from(weight);
                let bend = motion.parts[part].turn.cross(edge) * (0.25 * f64::from(weight));
                sum += Wrench {
                    straight: force,
                    turn: arm.cross(force) + edge.cross(bend),
                };
            }
            if self.stiffness.is_some() {
                for &node in self.parts.nodes_of(part) {
                    let node = node as usize;
                    let force = self.moved(motion, node, None) * stiffness(node);
                    sum += Wrench {
                        straight: force,
                        turn: (self.at(node) - center).cross(force),
                    };
                }
            }
            sum
        });
        Together { nodes, parts }
    }

    /// About the motion that forces would lead to: a cycle of the whole graph, with the mean motion of each part.
    fn preconditioned(
        &self,
        forces: &Together,
        workspace: &mut Workspace,
        pose: &PoseSolve<'_>,
    ) -> Result<Together, Error> {
        let spread = self.pool.map(self.parts.count(), 1, |part| {
            self.parts.moved_by(part, &self.places[part], forces.parts[part])
        });
        let rhs: Vec<[f64; 3]> = self
            .pool
            .map(self.body.nodes(), 1024, |node| match self.parts.part(node) {
                None => forces.nodes[node].to_array(),
                Some(part) => {
                    let arm = self.at(node) - self.places[part].center;
                    (spread[part].straight + spread[part].turn.cross(arm)).to_array()
                }
            });
        let mut moved = vec![0.0; 3 * self.body.nodes()];
        let options = SolveOptions {
            start: InitialGuess::Zero,
            tolerance: None,
            max_error: None,
            max_iterations: 1,
        };
        let equations = self
            .handles
            .positions
            .system
            .equations(&self.body.hierarchy, 3, rhs.as_flattened());
        equations.solve(&mut moved, &options, workspace, pose.exec, &mut |_| {
            SolveControl::Continue
        })?;
        let moved = moved.as_chunks::<3>().0;
        let at = |node: usize| DVec3::from_array(moved[node]);
        let nodes = self
            .pool
            .map(self.body.nodes(), 4096, |node| match self.is_alone(node) {
                true => at(node),
                false => DVec3::ZERO,
            });
        let parts = self.pool.map(self.parts.count(), 1, |part| {
            let center = self.places[part].center;
            let mut sum = Wrench::default();
            for &node in self.parts.nodes_of(part) {
                let moved = at(node as usize);
                sum += Wrench {
                    straight: moved,
                    turn: (self.at(node as usize) - center).cross(moved),
                };
            }
            self.parts.moved_by(part, &self.places[part], sum)
        });
        Ok(Together { nodes, parts })
    }
}
