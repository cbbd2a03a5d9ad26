//! The second pass: positions that agree best with the local frames (paper section 2.2, equations 8 and 11).

use super::equations::Posed;
use super::first_pass::{self, FirstPass, Frame, Turn};
use super::refine::Fit;
use super::rig::{Constrained, Rig};
use super::spatial_rbf::Space;
use super::{Body, Error, Refinement, Transform};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::progress::check;
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
    /// What refinement had added to the first pass's rotations in `x`; empty when it had not been asked for.
    extra: Vec<Turn>,
    rhs: Vec<f64>,
    workspace: Workspace,
    /// What [`Rig::solve_in_space`] made of the handles.
    pub(super) space: Option<Box<Space>>,
}

impl State {
    /// Bytes held on the heap.
    pub fn bytes(&self) -> usize {
        (self.x.capacity() + self.rhs.capacity()) * 8
            + self.extra.capacity() * 16
            + self.workspace.bytes()
            + self.space.as_ref().map_or(0, |space| space.bytes())
    }

    /// Where there is no last solution the rest shape is one, with all handles at rest.
    fn begin(&mut self, body: &Body, holds: usize) {
        if self.x.len() != body.nodes() * 3 {
            self.x.clear();
            self.x.extend_from_slice(body.rest.as_flattened());
            self.extra.clear();
            self.transforms = vec![Transform::IDENTITY; holds];
        }
    }

    /// Lets go of the last solution.
    pub(super) fn forget(&mut self) {
        self.x.clear();
        self.extra.clear();
    }
}

/// Where the solver starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// Full multigrid: the result depends on nothing but the request.
    Fresh,
    /// The last solution of the [`State`], or the rest shape when there is none, carried along with the handles.
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
    /// How rotations are spread from the handles.
    pub first_pass: FirstPass,
    /// Fitting rotations after the second pass.
    pub refinement: Refinement,
}

/// A solve under way, after one iteration.
pub struct Cycle<'a> {
    /// Iterations done, from 1.
    pub index: usize,
    /// How often rotations were fitted before this iteration.
    pub refined: u32,
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
    /// Frames by node, of the first pass or as refined; empty when nothing moved.
    pub frames: Vec<Frame>,
    /// How often rotations were fitted; less than was asked for when the solve was cut short.
    pub refined: u32,
    /// Iterations of the solver.
    pub iterations: usize,
    /// Relative residual, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// How it was solved.
    pub method: Method,
}

/// How a pose was solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// By two passes on the graph, and how the solver ended.
    Graph(solver::Method),
    /// By radial basis functions in space.
    SpatialRbf,
}

impl Solution {
    /// Nothing has moved.
    pub(super) fn at_rest(body: &Body) -> Self {
        Self {
            positions: body.graph.positions.clone(),
            frames: Vec::new(),
            refined: 0,
            iterations: 0,
            residual: 0.0,
            max_error: 0.0,
            method: Method::Graph(solver::Method::Trivial),
        }
    }
}

/// Largest missing displacement, as a fraction of the diagonal, with which rotations are fitted, unless a smaller residual
/// is asked for. Less would be lost on rotations that change again; with more, results would show how each coordinate was
/// solved.
const BETWEEN_FITS: f64 = 1e-4;

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
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&Cycle<'_>) -> bool,
    ) -> Result<Solution, Error> {
        let moved_parts = self.moved_parts(body, request.transforms);
        if !moved_parts.contains(&true) {
            return Ok(Solution::at_rest(body));
        }
        let instead = first_pass::instead(body, self, request.transforms, request.first_pass, exec)?;
        let instead = instead.as_deref();
        let pose = Pose {
            rig: self,
            body,
            request,
            instead,
            moved_parts: &moved_parts,
            exec,
        };
        let mut posed = self.posed(body, request.transforms, instead, exec.pool);
        let result = pose.solve(&mut posed, state, watch);
        if result.is_err() {
            // A solution that was interrupted is no start for the next one.
            state.forget();
        }
        result.map(|solution| Solution {
            frames: posed.frames,
            ..solution
        })
    }
}

/// One pose under way.
struct Pose<'a> {
    rig: &'a Rig,
    body: &'a Body,
    request: &'a Request<'a>,
    /// Rotations in place of the blend by harmonic fields.
    instead: Option<&'a [Turn]>,
    moved_parts: &'a [bool],
    exec: &'a Exec<'a>,
}

/// What the solves of one pose came to so far.
struct Tally {
    iterations: usize,
    refined: u32,
    /// `watch` has had enough.
    stopped: bool,
}

impl Pose<'_> {
    /// Solves for positions, and fits rotations as often as asked for. Leaves `posed.frames` as last solved with.
    fn solve(
        &self,
        posed: &mut Posed,
        state: &mut State,
        watch: &mut dyn FnMut(&Cycle<'_>) -> bool,
    ) -> Result<Solution, Error> {
        let Self {
            rig,
            body,
            request,
            exec: Exec { pool, .. },
            ..
        } = *self;
        let Refinement { steps, smoothing } = request.refinement;
        let warm = request.start == Start::Warm;
        if warm {
            state.begin(body, request.transforms.len());
            rig.carry(body, &state.transforms, request.transforms, &mut state.x, pool);
        }
        state.transforms.clear();
        state.transforms.extend_from_slice(request.transforms);
        prepare(body, rig, posed, warm, state, pool);
        let fit =
            (steps > 0).then(|| Fit::new(body, rig, request.transforms, self.moved_parts, self.instead, smoothing));
        let mut turns = match &fit {
            Some(fit) if warm && state.extra.len() == body.nodes() => {
                let turns = fit.resume(&state.extra, pool);
                posed.frames = fit.frames(&turns, pool);
                turns
            }
            Some(fit) => fit.start(pool),
            None => Vec::new(),
        };
        rig.assemble(body, posed, request.transforms, &mut state.rhs, pool);

        let mut tally = Tally {
            iterations: 0,
            refined: 0,
            stopped: false,
        };
        let first = match warm {
            true => solver::Start::Given,
            false => solver::Start::FullMultigrid {
                frames: Some(&posed.frames),
                rest: Some(&body.rest),
            },
        };
        let between = request.tolerance.map_or(BETWEEN_FITS, |t| t.min(BETWEEN_FITS));
        let rough = if steps > 0 { between } else { 0.0 };
        let mut stats = self.run(&rig.positions, posed.center, first, rough, state, &mut tally, watch)?;
        if let Some(fit) = &fit {
            while tally.refined < steps && !tally.stopped {
                check(self.exec.progress)?;
                turns = fit.step(&turns, &state.x, pool);
                posed.frames = fit.frames(&turns, pool);
                rig.assemble(body, posed, request.transforms, &mut state.rhs, pool);
                tally.refined += 1;
                let rough = if tally.refined < steps { between } else { 0.0 };
                let start = solver::Start::Given;
                stats = self.run(&rig.positions, posed.center, start, rough, state, &mut tally, watch)?;
            }
            state.extra = fit.extra(&turns, pool);
        } else {
            state.extra.clear();
        }
        if let Some(rigid) = &rig.rigid {
            rig.make_rigid(body, &mut state.x);
            let start = solver::Start::Given;
            stats = self.run(rigid, posed.center, start, 0.0, state, &mut tally, watch)?;
        }

        let positions = rig.place(body, self.moved_parts, request.transforms, posed.center, &state.x);
        if let Some(node) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Solver(format!("node {node} left the range of numbers")));
        }
        // Kept relative to nothing, so that the next solve may centre elsewhere.
        let center = posed.center.to_array();
        state
            .x
            .chunks_exact_mut(3)
            .for_each(|row| row.iter_mut().zip(center).for_each(|(v, c)| *v += c));
        Ok(Solution {
            positions,
            frames: Vec::new(),
            refined: tally.refined,
            iterations: tally.iterations,
            residual: stats.residual,
            max_error: stats.max_error * body.unit / body.diagonal,
            method: Method::Graph(stats.method),
        })
    }

    /// Solves the equations in `state`: to what the request asks for, or only to the error `rough`.
    fn run(
        &self,
        constrained: &Constrained,
        center: DVec3,
        start: solver::Start<'_>,
        rough: f64,
        state: &mut State,
        tally: &mut Tally,
        watch: &mut dyn FnMut(&Cycle<'_>) -> bool,
    ) -> Result<solver::Stats, Error> {
        let Self { rig, body, request, .. } = *self;
        let unit_per_diagonal = body.unit / body.diagonal;
        let options = SolveOptions {
            start,
            tolerance: request.tolerance,
            max_error: request.max_error.map(|e| e / unit_per_diagonal),
            ..Default::default()
        };
        let before = tally.iterations;
        let State { x, rhs, workspace, .. } = state;
        let stats = constrained.system.solve(
            &body.hierarchy,
            3,
            rhs,
            x,
            &options,
            workspace,
            self.exec,
            &mut |iteration| {
                let positions = || {
                    let mut now = vec![0.0; body.nodes() * 3];
                    iteration.copy_to(&mut now);
                    rig.place(body, self.moved_parts, request.transforms, center, &now)
                };
                let cycle = Cycle {
                    index: before + iteration.index,
                    refined: tally.refined,
                    residual: iteration.residual,
                    max_error: iteration.max_error * unit_per_diagonal,
                    positions: &positions,
                };
                tally.stopped = !watch(&cycle);
                match tally.stopped || (iteration.index > 1 && cycle.max_error <= rough) {
                    true => Control::Stop,
                    false => Control::Continue,
                }
            },
        )?;
        tally.iterations += stats.iterations;
        Ok(stats)
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
