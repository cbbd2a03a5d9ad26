//! The outer iteration: flexible conjugate gradients on all columns of a group, preconditioned by one multigrid cycle.
//!
//! It goes in *runs*. A run begins with the residual in double precision and iterates a correction in single
//! precision. Once rounding shows in the residual, the correction is added to the solution and the next run
//! begins from the true residual, in the same search direction: single precision never limits the result.

use crate::error::Error;
use crate::lanes::{Lanes, WIDTH, WideLanes};
use crate::solve::advance::{first_residual, residual, resume_direction, rhs_reference_norms};
use crate::solve::cycle::{clear_inactive, prepare};
use crate::solve::fallback::conjugate_gradients;
use crate::solve::frame_rows::FrameRows;
use crate::solve::group::{GroupOutcome, GroupSolve, IterationWatcher, LeftResidual, Workspace};
use crate::solve::inner::{InnerEnd, OuterState};
use crate::solve::problem::{ColumnGroup, posed_residual};
use crate::threads::Parallelism;
use pliant_exec::pool::Pool;

/// Iterations that solves stay below unless something is wrong: their history has room from the first solve on.
const USUAL: usize = 64;
/// Rounding of the step of a whole pose, relative to the largest diagonal times its norm: that of single precision.
const STEP_ROUNDING: f64 = 6e-8;
/// A residual made from the step is taken where that is at most this part of it.
const TRUSTED: f64 = 0.1;
/// Runs in a row that may fail to halve the true residual.
const POOR_RUNS: usize = 2;

impl GroupSolve<'_, '_> {
    /// Iterates on `workspace.x` from the values it holds.
    pub(crate) fn solve(&mut self, watch: &mut IterationWatcher<'_>) -> Result<GroupOutcome, Error> {
        let problem = self.problem;
        self.prepare_vectors();
        let mut state = OuterState::new();
        let mut norms = self.load_first_residual(&mut state);
        loop {
            norms = self.ensure_finite(norms, &state)?;
            state.judge_residual(norms, &self.criteria, problem.width());
            if let Some(recalled) = self.recalled.as_ref().filter(|_| self.left.is_none()) {
                state.judge_recalled(recalled, &self.criteria, problem.width());
            }
            if state.outcome.converged || state.outcome.iterations >= self.criteria.max_iterations {
                self.reached = state.reached();
                self.left = (state.outcome.iterations == 0).then_some(LeftResidual {
                    squares: norms,
                    reference: state.reference,
                });
                return Ok(state.outcome);
            }
            state.count_poor_run();
            let relative = state.outcome.relative;
            if state.poor >= POOR_RUNS {
                if at_rounding(&problem, &self.workspace.x, relative, state.reference) {
                    return Ok(state.outcome);
                }
                return conjugate_gradients(self, state.reference, state.outcome, watch);
            }
            match self.inner_iterations(&mut state, watch)? {
                InnerEnd::Accepted => {
                    self.reached = state.reached();
                    return Ok(state.accepted());
                }
                InnerEnd::Ended => {}
                InnerEnd::Stagnated => {
                    state.poor += 1;
                    state.direction = None;
                }
                InnerEnd::NotFinite => {
                    state.outcome.relative = relative;
                    return conjugate_gradients(self, state.reference, state.outcome, watch);
                }
            }
            norms = self.load_next_residual(&mut state);
        }
    }

    /// Sizes the vectors and clears what iterations read without having written it.
    fn prepare_vectors(&mut self) {
        let grid = self.cycle.grid(0);
        let Workspace {
            fine,
            coarse,
            history,
            solves,
            ..
        } = &mut *self.workspace;
        history.clear();
        history.reserve(USUAL);
        *solves = solves.wrapping_add(1);
        fine.resize(self.problem.hierarchy.levels[0].rows());
        // A solve that was cancelled or ruined has left a correction behind.
        clear(&mut fine.e, self.problem.threads, self.pool);
        clear_inactive(&grid, &mut fine.z);
        clear_inactive(&grid, &mut fine.t);
        clear_inactive(&grid, &mut fine.last_e);
        prepare(&self.cycle, coarse);
    }

    /// Makes the residual that the first run begins with, and the norms that residuals are relative to. Returns its
    /// squared norms.
    fn load_first_residual(&mut self, state: &mut OuterState) -> WideLanes {
        let (problem, from_zero) = (self.problem, self.from_zero);
        if let Some(left) = self.left {
            state.reference = left.reference;
            return left.squares;
        }
        if let Some(frames) = problem.frames() {
            return self.load_posed_residual(frames, state);
        }
        self.cycle.progress.begin_pass("residual");
        let Workspace { x, fine, .. } = &mut *self.workspace;
        problem.threads.run_on(self.pool, || {
            if from_zero {
                let norms = first_residual(&problem, x, fine);
                state.reference = norms.map(f64::sqrt);
                norms
            } else {
                state.reference = rhs_reference_norms(&problem, x);
                residual(&problem, x, fine, state.scale)
            }
        })
    }

    /// The same for a pose: right-hand side, residual and both norms in one pass; then what earlier poses came to is taken out
    /// of it.
    fn load_posed_residual(&mut self, frames: FrameRows<'_>, state: &mut OuterState) -> WideLanes {
        let problem = self.problem;
        self.cycle.progress.begin_pass("residual");
        let Workspace { x, fine, .. } = &mut *self.workspace;
        let recalled = self.recalled.as_deref_mut();
        let progress = self.cycle.progress;
        problem.threads.run_on(self.pool, || {
            let [norms, reference] = posed_residual(&problem, &frames, x, &mut fine.r);
            state.reference = reference.map(f64::sqrt);
            let Some(recalled) = recalled else { return norms };
            progress.begin_pass("recall");
            recalled.take_out(&problem, x, &mut fine.r).unwrap_or(norms)
        })
    }

    /// Makes the residual that the next run begins with, in a scale of its own and in the direction of the last step.
    /// Returns its squared norms.
    fn load_next_residual(&mut self, state: &mut OuterState) -> WideLanes {
        let problem = self.problem;
        let factor = state.rescale(problem.hierarchy.levels[0].rows());
        let grid = self.cycle.grid(0);
        self.cycle.progress.begin_pass("residual");
        let Workspace { x, fine, .. } = &mut *self.workspace;
        let recalled = self.recalled.as_deref();
        problem.threads.run_on(self.pool, || {
            let followed = recalled.and_then(|recalled| {
                let [squares, lengths] = recalled.residual(&grid, &mut fine.r, &mut fine.partials, state.scale);
                let noise = |c: usize| STEP_ROUNDING * problem.hierarchy.largest_diagonal * lengths[c].sqrt();
                let is_sound = (0..problem.width()).all(|c| noise(c) <= TRUSTED * squares[c].sqrt());
                is_sound.then_some(squares)
            });
            let norms = followed.unwrap_or_else(|| residual(&problem, x, fine, state.scale));
            resume_direction(&grid, fine, factor, &mut state.direction);
            norms
        })
    }

    /// Returns the squared norms of a residual that is finite: the one of `norms`, or that of a start from 0.
    fn ensure_finite(&mut self, mut norms: WideLanes, state: &OuterState) -> Result<WideLanes, Error> {
        let problem = self.problem;
        let iterations = state.outcome.iterations;
        let is_finite = |norms: &WideLanes| norms.iter().all(|r| r.is_finite());
        if !is_finite(&norms) && iterations == 0 && problem.frames().is_none() {
            // Frames of absurd size can overflow the full-multigrid start.
            let Workspace { x, fine, .. } = &mut *self.workspace;
            problem.load(self.caller, false, x);
            norms = problem
                .threads
                .run_on(self.pool, || residual(&problem, x, fine, state.scale));
        }
        if !is_finite(&norms) {
            return Err(Error::Diverged {
                iterations,
                residual: f64::INFINITY,
            });
        }
        Ok(norms)
    }
}

/// Sets all rows to 0.
fn clear(v: &mut [Lanes], threads: Parallelism, pool: &Pool) {
    const PIECE: usize = 1 << 14;
    let threads = threads.for_rows(v.len());
    threads.run_on(pool, || {
        threads.for_each_piece(PIECE, v, |_, rows| rows.fill(Lanes::ZERO))
    });
}

/// True if the residual is about what computing it in double precision leaves, so that no method can go on.
fn at_rounding(problem: &ColumnGroup<'_>, x: &[WideLanes], relative: WideLanes, reference: WideLanes) -> bool {
    const PRODUCT: f64 = 100.0 * f64::EPSILON;
    let mut squares = [0.0; WIDTH];
    for x in x {
        for c in 0..WIDTH {
            squares[c] += x[c] * x[c];
        }
    }
    let limit = PRODUCT * problem.hierarchy.largest_diagonal;
    (0..WIDTH).all(|c| relative[c] * reference[c] <= limit * squares[c].sqrt())
}
