//! The second pass: positions that agree best with the local frames (paper section 2.2, equations 8 and 11).

use super::equations::Posed;
use super::first_pass::Frame;
use super::rig::{Constrained, NOBODY, Rig};
use super::{Body, Error, Transform, rigid_fit};
use crate::pool::Pool;
use crate::progress::Progress;
use crate::solver::{self, Control, SolveOptions, Workspace};
use glam::DVec3;
use rayon::prelude::*;

/// What a solve keeps for the next one: the last solution and scratch memory.
#[derive(Default)]
pub struct State {
    /// Solving coordinates by node; empty before the first solve.
    x: Vec<f64>,
    /// Where the handles were for `x`.
    transforms: Vec<Transform>,
    rhs: Vec<f64>,
    workspace: Workspace,
}

impl State {
    /// Bytes held on the heap.
    pub fn bytes(&self) -> usize {
        (self.x.capacity() + self.rhs.capacity()) * 8 + self.workspace.bytes()
    }
}

/// Where the solver starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// Full multigrid: the result depends on nothing but the request.
    Fresh,
    /// The last solution of the [`State`], or fresh when there is none.
    Warm,
}

/// A pose to solve.
pub struct Request<'a> {
    /// By hold of the rig.
    pub transforms: &'a [Transform],
    /// Relative residual to reach (the paper's), when given.
    pub tolerance: Option<f64>,
    /// Largest missing displacement to reach, as a fraction of the diagonal, when given.
    pub max_error: Option<f64>,
    /// Where to start.
    pub start: Start,
}

/// A solve under way, after one iteration.
pub struct Cycle<'a> {
    /// Iterations done, from 1.
    pub index: usize,
    /// Relative residual, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// Makes the positions of all nodes, model space.
    pub positions: &'a dyn Fn() -> Vec<DVec3>,
}

/// A solved pose.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Positions of all graph nodes, model space; the first `graph.surface` are the mesh's vertices. Parts in which no
    /// handle has moved keep their rest positions to the bit.
    pub positions: Vec<DVec3>,
    /// The first-pass frames by node; empty when nothing moved.
    pub frames: Vec<Frame>,
    /// Iterations of the solver.
    pub iterations: usize,
    /// Relative residual, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// How the solver ended.
    pub method: solver::Method,
}

impl Rig {
    /// Solves a pose. `watch` is called after every iteration; `false` takes the result as it is.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`]. `state` stays usable after either.
    pub fn solve(
        &self,
        body: &Body,
        request: &Request<'_>,
        state: &mut State,
        pool: &Pool,
        progress: &dyn Progress,
        watch: &mut dyn FnMut(&Cycle<'_>) -> bool,
    ) -> Result<Solution, Error> {
        let moved_parts = self.moved_parts(body, request.transforms);
        if !moved_parts.contains(&true) {
            return Ok(Solution {
                positions: body.graph.positions.clone(),
                frames: Vec::new(),
                iterations: 0,
                residual: 0.0,
                max_error: 0.0,
                method: solver::Method::Trivial,
            });
        }
        let posed = self.posed(body, request.transforms, pool);
        let center = posed.center;
        let warm = request.start == Start::Warm && state.x.len() == body.nodes() * 3;
        if warm {
            self.carry(body, &state.transforms, request.transforms, &mut state.x, pool);
        }
        state.transforms.clear();
        state.transforms.extend_from_slice(request.transforms);
        prepare(body, self, &posed, warm, state, pool);
        self.assemble(body, &posed, request.transforms, &mut state.rhs, pool);

        let unit_per_diagonal = body.unit / body.diagonal;
        let start = match warm {
            true => solver::Start::Given,
            false => solver::Start::FullMultigrid {
                frames: Some(&posed.frames),
                rest: Some(&body.rest),
            },
        };
        let options = SolveOptions {
            start,
            tolerance: request.tolerance,
            max_error: request.max_error.map(|e| e / unit_per_diagonal),
            ..Default::default()
        };
        let placed = |x: &[f64]| self.place(body, &moved_parts, request.transforms, center, x);
        let State { x, rhs, workspace, .. } = state;
        let mut run = |constrained: &Constrained, options: &SolveOptions<'_>, x: &mut Vec<f64>| {
            constrained.system.solve(
                &body.hierarchy,
                3,
                rhs,
                x,
                options,
                workspace,
                pool,
                progress,
                &mut |iteration| {
                    let positions = || {
                        let mut now = vec![0.0; body.nodes() * 3];
                        iteration.copy_to(&mut now);
                        placed(&now)
                    };
                    let cycle = Cycle {
                        index: iteration.index,
                        residual: iteration.residual,
                        max_error: iteration.max_error * unit_per_diagonal,
                        positions: &positions,
                    };
                    if watch(&cycle) {
                        Control::Continue
                    } else {
                        Control::Stop
                    }
                },
            )
        };
        let result = run(&self.positions, &options, x).and_then(|mut stats| {
            if let Some(rigid) = &self.rigid {
                self.make_rigid(body, x);
                let again = run(
                    rigid,
                    &SolveOptions {
                        start: solver::Start::Given,
                        ..options.clone()
                    },
                    x,
                )?;
                stats = solver::Stats {
                    iterations: stats.iterations + again.iterations,
                    ..again
                };
            }
            Ok(stats)
        });
        let stats = match result {
            Ok(stats) => stats,
            Err(e) => {
                // A solution that was interrupted is no start for the next one.
                state.x.clear();
                return Err(e.into());
            }
        };
        let positions = placed(&state.x);
        if let Some(node) = positions.iter().position(|p| !p.is_finite()) {
            state.x.clear();
            return Err(Error::Solver(format!("node {node} left the range of numbers")));
        }
        // Kept relative to nothing, so that the next solve may centre elsewhere.
        state
            .x
            .chunks_exact_mut(3)
            .for_each(|row| row.iter_mut().zip(center.to_array()).for_each(|(v, c)| *v += c));
        Ok(Solution {
            positions,
            frames: posed.frames,
            iterations: stats.iterations,
            residual: stats.residual,
            max_error: stats.max_error * unit_per_diagonal,
            method: stats.method,
        })
    }

    /// By component: whether any hold that has moved has a say in it.
    fn moved_parts(&self, body: &Body, transforms: &[Transform]) -> Vec<bool> {
        let mut moved = vec![false; body.graph.components];
        for (hold, _) in self
            .rigging
            .holds
            .iter()
            .zip(transforms)
            .filter(|(_, t)| !t.is_identity())
        {
            let nodes = hold.nodes.iter().copied().chain(hold.pulls.iter().map(|p| p.0));
            nodes.for_each(|n| moved[body.graph.component[n as usize] as usize] = true);
        }
        moved
    }

    /// Model-space positions of all nodes from solving coordinates around `center`: parts that nothing moved and nodes
    /// held by handles are set to the bit, loose parts are placed.
    fn place(
        &self,
        body: &Body,
        moved_parts: &[bool],
        transforms: &[Transform],
        center: DVec3,
        x: &[f64],
    ) -> Vec<DVec3> {
        let maps: Vec<_> = transforms.iter().map(Transform::map).collect();
        let mut positions: Vec<DVec3> = (0..body.nodes())
            .map(|i| {
                let rest = body.graph.positions[i];
                if !moved_parts[body.graph.component[i] as usize] {
                    return rest;
                }
                match self.position.hard[i] {
                    NOBODY if self.positions.fixed[i] => rest,
                    NOBODY => body.model_from_solving(DVec3::from_slice(&x[i * 3..i * 3 + 3]) + center),
                    k => maps.get(k as usize).map_or(rest, |map| map(rest)),
                }
            })
            .collect();
        self.parts.place(body, &mut positions);
        positions
    }

    /// Replaces the solution on rigid regions by the rigid motion that fits it best.
    fn make_rigid(&self, body: &Body, x: &mut [f64]) {
        for hold in self
            .rigging
            .holds
            .iter()
            .filter(|h| h.rigid && !(h.position && h.stiffness.is_none()))
        {
            let at = |n: &u32| DVec3::from_slice(&x[*n as usize * 3..*n as usize * 3 + 3]);
            let rest: Vec<_> = hold
                .nodes
                .iter()
                .map(|n| DVec3::from_array(body.rest[*n as usize]))
                .collect();
            let now: Vec<_> = hold.nodes.iter().map(at).collect();
            let map = rigid_fit(&rest, &now).map();
            for (n, p) in hold.nodes.iter().zip(&rest) {
                let n = *n as usize;
                if self.position.hard[n] == NOBODY {
                    x[n * 3..n * 3 + 3].copy_from_slice(&map(*p).to_array());
                }
            }
        }
    }
}

/// Sizes `state` and fills `state.x`, around the pose's centre: given values, and the start of a warm solve.
fn prepare(body: &Body, rig: &Rig, posed: &Posed, warm: bool, state: &mut State, pool: &Pool) {
    let nodes = body.nodes();
    state.x.resize(nodes * 3, 0.0);
    state.rhs.resize(nodes * 3, 0.0);
    let x = &mut state.x;
    pool.install(|| {
        x.par_chunks_exact_mut(3)
            .with_min_len(4096)
            .enumerate()
            .for_each(|(i, x)| {
                let value = match rig.positions.fixed[i] || !warm {
                    true => posed.targets[i],
                    false => DVec3::from_slice(x),
                };
                x.copy_from_slice(&(value - posed.center).to_array());
            });
    });
}
