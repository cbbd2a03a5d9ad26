//! [`HandleSystem::solve`]: a pose from transforms to positions, both passes in turn, and the second pass itself (paper section 2.2,
//! equations 8 and 11).

use crate::body::DeformableBody;
use crate::border_frames::BorderFrames;
use crate::error::Error;
use crate::first_pass::blend::LocalRotation;
use crate::first_pass::spread::{FirstRotations, blend_frames_with};
use crate::handles::system::{ConstrainedSystem, HandleSystem};
use crate::pose::{FitOrder, PoseRequest, PoseStats, SolveStart, SolveUpdate, SolvedNodes};
use crate::rotation::Transform;
use crate::second_pass::equations::{PosedHandles, Precision};
use crate::second_pass::refine::RotationFit;
use crate::second_pass::single_precision::frames_of;
use crate::second_pass::state::SolveState;
use crate::volume_scales::VolumeScales;
use glam::{DMat3, DVec3};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::check;
use pliant_solver::{SolveControl, SolveOptions, StoppingCriteria};
use rayon::prelude::*;

/// Largest missing displacement, as a fraction of the diagonal, with which rotations are fitted, unless a smaller residual
/// is asked for. Less would be lost on rotations that change again; with more, results would show how each coordinate was
/// solved.
const BETWEEN_FITS: f64 = 1e-4;
/// Iterations at most of one solve.
const MOST_ITERATIONS: usize = 200;

impl HandleSystem {
    /// Solves a pose. `watch` is called after every iteration; `false` takes the result as it is.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`]. `state` stays usable after either.
    pub fn solve(
        &self,
        body: &DeformableBody,
        request: &PoseRequest<'_>,
        state: &mut SolveState,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<SolvedNodes, Error> {
        let moved_parts = self.moved_parts(body, request.transforms);
        if !moved_parts.contains(&true) {
            return Ok(SolvedNodes::at_rest(body));
        }
        let pose = PoseSolve {
            handles: self,
            body,
            request,
            moved_parts: &moved_parts,
            exec,
        };
        if pose.can_drag() {
            match pose.drag(state, watch) {
                // Poses beyond the range of single precision.
                Err(Error::Solver(_)) => state.forget(),
                Err(other) => {
                    state.forget();
                    return Err(other);
                }
                done => return done,
            }
        }
        match request.start.is_last() {
            true => state.rows.hand_over(body, &mut state.x),
            false => state.rows.let_go(),
        }
        exec.progress.begin_pass("blend");
        let first = FirstRotations::of(body, self, request, exec.pool);
        let frames = match first.instead.as_deref() {
            Some(turns) if first.is_animation && !has_scales(request.transforms) => frames_of(turns, exec.pool),
            instead => blend_frames_with(body, self, request.transforms, instead, exec.pool),
        };
        let precision = match first.is_animation {
            true => Precision::Single,
            false => Precision::Double,
        };
        exec.progress.begin_pass("carry");
        let mut posed = self.pose_handles(body, request.transforms, frames, precision, exec.pool);
        let result = pose.solve(&first, &mut posed, state, watch);
        if result.is_err() {
            // A solution that was interrupted is not a start for the next one.
            state.forget();
        }
        result.map(|solution| SolvedNodes {
            frames: posed.frames,
            ..solution
        })
    }
}

/// One pose under way.
pub(crate) struct PoseSolve<'a> {
    pub handles: &'a HandleSystem,
    pub body: &'a DeformableBody,
    pub request: &'a PoseRequest<'a>,
    /// By component: whether any handle that moved has a say in it.
    pub moved_parts: &'a [bool],
    pub exec: &'a Exec<'a>,
}

/// What the solves of one pose came to so far, and who watches them.
pub(crate) struct SolveTally<'a> {
    pub iterations: usize,
    pub refined: u32,
    /// What is solved around, in solving coordinates.
    pub center: DVec3,
    pub watch: &'a mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    /// `watch` has had enough.
    pub stopped: bool,
}

impl PoseSolve<'_> {
    /// Solves for positions, and fits rotations as often as asked for. Leaves `posed.frames` as last solved with.
    fn solve(
        &self,
        first: &FirstRotations<'_>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<SolvedNodes, Error> {
        let (handles, body, request, pool) = (self.handles, self.body, self.request, self.exec.pool);
        let warm = request.start.is_last();
        if self.smooths_borders() {
            state.borders = BorderFrames::default();
        }
        if warm {
            state.begin(body, request.transforms.len());
            let (from, to) = (&state.transforms, request.transforms);
            match first.is_animation {
                true => handles.carry_by_shares(body, from, to, &mut state.x, pool),
                false => handles.carry(body, from, to, &mut state.x, pool),
            }
        }
        state.transforms.clear();
        state.transforms.extend_from_slice(request.transforms);
        prepare(body, handles, posed, warm, state, pool);
        let fit = (request.steps() > 0).then(|| RotationFit::new(body, handles, request, self.moved_parts, first));
        let mut tally = SolveTally {
            iterations: 0,
            refined: 0,
            center: posed.center,
            watch,
            stopped: false,
        };
        let coarse = fit.as_ref().filter(|fit| self.may_begin_coarse(first, fit));
        let coarse = coarse.map(|fit| self.fit_coarse_first(fit, posed, state, &mut tally));
        let mut stats = match coarse {
            Some(Err(Error::Solver(_))) => {
                // Poses beyond the range of single precision.
                state.forget();
                if warm {
                    state.begin(body, request.transforms.len());
                    state.transforms.clone_from_slice(request.transforms);
                }
                prepare(body, handles, posed, warm, state, pool);
                self.fit_in_turn(fit.as_ref(), posed, state, &mut tally)?
            }
            Some(solved) => solved?,
            None => self.fit_in_turn(fit.as_ref(), posed, state, &mut tally)?,
        };
        if handles.places.has_any_points() {
            stats = self
                .settle_points(fit.as_ref(), posed, state, &mut tally)?
                .unwrap_or(stats);
        }
        if let Some(fit) = &fit {
            state.volume = VolumeScales::default();
            if self.smooths_borders() {
                stats = self.smooth_borders(fit, posed, state, &mut tally)?.unwrap_or(stats);
            }
            if self.keeps_volume() {
                stats = self.keep_volume(fit, posed, state, &mut tally)?.unwrap_or(stats);
            }
        }
        if !handles.stiff.is_empty() {
            self.stiffen(fit.as_ref(), posed, state)?;
        }
        self.finish(stats, posed, state, &mut tally)
    }

    /// Makes rigid regions rigid, and takes the solution out of `state`, which keeps it relative to nothing.
    pub(crate) fn finish(
        &self,
        mut stats: pliant_solver::SolveStats,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<SolvedNodes, Error> {
        let (handles, body, request, pool) = (self.handles, self.body, self.request, self.exec.pool);
        if let Some(rigid) = &handles.rigid {
            handles.make_regions_rigid(body, request.transforms, &mut posed.frames, &mut state.x);
            self.assemble(posed, state);
            let start = pliant_solver::InitialGuess::Given;
            stats = self.run(rigid, start, 0.0, state, tally)?;
        }

        self.exec.progress.begin_pass("place");
        let positions = self.place(posed.center, &state.x);
        if let Some(node) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Solver(format!("node {node} left the range of numbers")));
        }
        // Kept relative to nothing, so that the next solve may centre elsewhere.
        let center = posed.center.to_array();
        pool.install(|| {
            let rows = state.x.as_chunks_mut::<3>().0.par_iter_mut().with_min_len(4096);
            rows.for_each(|row| row.iter_mut().zip(center).for_each(|(v, c)| *v += c));
        });
        Ok(SolvedNodes {
            positions,
            frames: Vec::new(),
            stats: self.stats(&stats, tally.iterations, tally.refined),
        })
    }

    /// Solves, and fits rotations and solves again as often as asked for, all on the graph itself.
    fn fit_in_turn(
        &self,
        fit: Option<&RotationFit<'_>>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<pliant_solver::SolveStats, Error> {
        let (handles, body, request, pool) = (self.handles, self.body, self.request, self.exec.pool);
        let steps = request.steps();
        let carried = request.fits == FitOrder::Carried || request.start == SolveStart::Shape;
        let warm = request.start.is_last();
        let mut turns = match fit {
            Some(fit) if warm && state.extra.len() == body.nodes() => {
                let turns = resumed(fit, carried, state, pool);
                posed.frames = fit.frames(&turns, pool);
                turns
            }
            Some(fit) => fit.start(pool),
            None => Vec::new(),
        };
        self.assemble(posed, state);
        let rest = (!warm).then(|| self.body.rest_of_all(pool));
        let first = match warm {
            true => pliant_solver::InitialGuess::Given,
            false => pliant_solver::InitialGuess::FullMultigrid {
                frames: Some(&posed.frames),
                rest: rest.as_deref(),
            },
        };
        let between = request.quality.tolerance.map_or(BETWEEN_FITS, |t| t.min(BETWEEN_FITS));
        let rough = if steps > 0 { between } else { 0.0 };
        let mut stats = self.run(&handles.positions, first, rough, state, tally)?;
        let Some(fit) = fit else {
            state.extra.clear();
            return Ok(stats);
        };
        while tally.refined < steps && !tally.stopped {
            check(self.exec.progress)?;
            turns = fit.step(&turns, &state.x, pool);
            posed.frames = fit.frames(&turns, pool);
            self.assemble(posed, state);
            tally.refined += 1;
            let rough = if tally.refined < steps { between } else { 0.0 };
            let start = pliant_solver::InitialGuess::Given;
            stats = self.run(&handles.positions, start, rough, state, tally)?;
        }
        state.extra = fit.extra(&turns, pool);
        Ok(stats)
    }

    /// When a solve to what the request asks for stops, in solving coordinates.
    pub(crate) fn criteria(&self) -> StoppingCriteria {
        let unit_per_diagonal = self.body.unit / self.body.diagonal;
        StoppingCriteria {
            tolerance: self.request.quality.tolerance,
            max_error: self.request.quality.max_error.map(|e| e / unit_per_diagonal),
            max_iterations: MOST_ITERATIONS,
        }
    }

    /// What `last`, the last solve after so many iterations and fits, came to.
    pub(crate) fn stats(&self, last: &pliant_solver::SolveStats, iterations: usize, refined: u32) -> PoseStats {
        PoseStats {
            cycles: u32::try_from(iterations).unwrap_or(u32::MAX),
            refined,
            residual: last.residual,
            max_error: last.max_error * self.body.unit / self.body.diagonal,
            solver: last.method.name(),
        }
    }

    /// Fills the right-hand side for `posed`, of a pose that is fitted with the corrections at borders that were found for it.
    pub(crate) fn assemble(&self, posed: &mut PosedHandles, state: &mut SolveState) {
        self.exec.progress.begin_pass("equations");
        let transforms = self.request.transforms;
        state.rhs.resize(3 * self.body.nodes(), 0.0);
        let borders = Some(&state.borders).filter(|borders| self.smooths_borders() && !borders.is_empty());
        let uncorrected = borders.map(|borders| borders.put_into(&mut posed.frames));
        (self.handles).assemble(self.body, posed, &mut state.rhs, self.exec.pool);
        let (x, rhs) = (&state.x, &mut state.rhs);
        let at = |node: usize| DVec3::from_slice(&x[3 * node..3 * node + 3]);
        (self.handles).scatter(self.body, posed, transforms, at, rhs);
        if let Some((borders, uncorrected)) = borders.zip(uncorrected) {
            borders.take_back(uncorrected, &mut posed.frames);
        }
    }

    /// Solves the equations in `state`: to what the request asks for, or only to the error `rough`.
    pub(crate) fn run(
        &self,
        constrained: &ConstrainedSystem,
        start: pliant_solver::InitialGuess<'_>,
        rough: f64,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<pliant_solver::SolveStats, Error> {
        let body = self.body;
        let unit_per_diagonal = body.unit / body.diagonal;
        let StoppingCriteria {
            tolerance,
            max_error,
            max_iterations,
        } = self.criteria();
        let options = SolveOptions {
            start,
            tolerance,
            max_error,
            max_iterations,
        };
        let before = tally.iterations;
        let SolveState { x, rhs, workspace, .. } = state;
        let stats = constrained.system.equations(&body.hierarchy, 3, rhs).solve(
            x,
            &options,
            workspace,
            self.exec,
            &mut |iteration| {
                self.report_cycle(iteration, before, tally);
                match tally.stopped || (iteration.index > 1 && iteration.max_error * unit_per_diagonal <= rough) {
                    true => SolveControl::Stop,
                    false => SolveControl::Continue,
                }
            },
        )?;
        tally.iterations += stats.iterations;
        Ok(stats)
    }

    /// Reports an iteration after `before` others to the watcher, and notes whether to stop.
    pub(crate) fn report_cycle(
        &self,
        done: &pliant_solver::IterationReport<'_>,
        before: usize,
        tally: &mut SolveTally<'_>,
    ) {
        let body = self.body;
        let positions = || {
            let mut now = vec![0.0; body.nodes() * 3];
            done.copy_to(&mut now);
            self.place(tally.center, &now)
        };
        let update = SolveUpdate {
            cycle: u32::try_from(before + done.index).unwrap_or(u32::MAX),
            refined: tally.refined,
            residual: done.residual,
            max_error: done.max_error * (body.unit / body.diagonal),
            positions: &positions,
        };
        tally.stopped = !(tally.watch)(&update);
    }

    /// Model-space positions of all nodes from solving coordinates around `center`.
    fn place(&self, center: DVec3, x: &[f64]) -> Vec<DVec3> {
        let placement = (self.handles).placement(self.body, self.moved_parts, self.request.transforms, center);
        placement.of_all(x, self.exec.pool)
    }
}

fn has_scales(transforms: &[Transform]) -> bool {
    transforms.iter().any(|t| t.log_scale != DMat3::ZERO)
}

/// The rotations that a warm solve goes on from.
fn resumed(fit: &RotationFit<'_>, carried: bool, state: &SolveState, pool: &Pool) -> Vec<LocalRotation> {
    let turns = fit.resume(&state.extra, pool);
    match carried {
        true => fit.step(&turns, &state.x, pool),
        false => turns,
    }
}

/// Sizes `state` and fills `state.x`, around the pose's centre: given values, and the start of a warm solve.
pub(crate) fn prepare(
    body: &DeformableBody,
    handles: &HandleSystem,
    posed: &PosedHandles,
    warm: bool,
    state: &mut SolveState,
    pool: &Pool,
) {
    let nodes = body.nodes();
    state.x.resize(nodes * 3, 0.0);
    let x = &mut state.x;
    pool.install(|| {
        x.par_chunks_exact_mut(3)
            .with_min_len(4096)
            .enumerate()
            .for_each(|(i, x)| {
                let value = match handles.positions.fixed[i] || !warm {
                    true => posed.targets[i],
                    false => DVec3::from_slice(x),
                };
                x.copy_from_slice(&(value - posed.center).to_array());
            });
    });
}
