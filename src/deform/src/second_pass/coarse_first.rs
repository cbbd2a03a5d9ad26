//! Rotations fitted on coarse levels before any is fitted on the graph itself.
//!
//! Fitting and solving in turn creeps where parts are slender. The solver's coarse levels show the same slow bends and cost next
//! to nothing, so the start by full multigrid fits there first, until the energy hardly falls. On the graph itself two or three
//! fits are left to do, a cycle after each, in the order of the solver's rows; they end once the energy hardly falls either.

use crate::error::Error;
use crate::first_pass::blend::LocalFrame;
use crate::first_pass::spread::FirstRotations;
use crate::pose::{FitOrder, SolveStart};
use crate::second_pass::drag::{SINGLE_ERROR, SINGLE_TOLERANCE, fill_scattered};
use crate::second_pass::equations::PosedHandles;
use crate::second_pass::refine::RotationFit;
use crate::second_pass::state::{NO_NODE, SolveState};
use crate::solve::{PoseSolve, SolveTally};
use glam::{Mat3, Quat};
use pliant_exec::pool::Pool;
use pliant_exec::progress::check;
use pliant_solver::{PoseRows, SolveControl, SolveStats};
use rayon::prelude::*;

/// Fits on the graph end where one has made the energy fall by less than this part of it.
const ENOUGH: f64 = 0.01;
/// The same on graphs of up to [`SMALL`] nodes, where a fit is nothing.
const ENOUGH_OF_SMALL: f64 = 0.002;
const SMALL: usize = 1 << 15;

impl PoseSolve<'_> {
    /// Whether fits may begin on coarse levels: not where more is asked for than single precision gives, for how nodes are grouped
    /// shows in the result by what the energy is still short of its least.
    pub(crate) fn may_begin_coarse(&self, first: &FirstRotations<'_>, fit: &RotationFit<'_>) -> bool {
        let request = self.request;
        // A warm pose with targets goes on from where the last one was: its fits are fast, and on the graph alone.
        let is_drag_to_targets = request.start == SolveStart::Warm && self.handles.places.has_targets();
        (request.start == SolveStart::Fresh || is_drag_to_targets)
            && request.fits == FitOrder::CoarseFirst
            && !first.is_animation
            && fit.is_plain()
            && request.quality.tolerance.is_none_or(|t| t >= SINGLE_TOLERANCE)
            && request.quality.max_error.is_none_or(|e| e >= SINGLE_ERROR)
            && self.handles.positions.system.can_solve_poses()
    }

    /// Solves and fits. Leaves positions in `state.x`, around the centre, and `posed.frames` as last solved with.
    ///
    /// # Errors
    /// [`Error::Solver`] where numbers left the range of single precision, [`Error::Cancelled`]. Positions are then of no use.
    pub(crate) fn fit_coarse_first(
        &self,
        fit: &RotationFit<'_>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<SolveStats, Error> {
        let (handles, body, exec) = (self.handles, self.body, self.exec);
        let system = &handles.positions.system;
        exec.progress.begin_pass("load");
        let is_warm = self.request.start == SolveStart::Warm;
        let resumed = (is_warm && state.extra.len() == body.nodes()).then(|| fit.resume(&state.extra, exec.pool));
        let first = resumed.map(|turns| std::mem::replace(&mut posed.frames, fit.frames(&turns, exec.pool)));
        self.load_rows(fit, posed, state);
        if let Some(first) = first {
            posed.frames = first;
        }
        self.pull_scattered(state);
        if !is_warm {
            let SolveState { rows, workspace, .. } = state;
            system.start_pose(&body.hierarchy, &mut rows.pose, workspace, exec)?;
            self.pull_scattered(state);
        }
        let mut stats = self.run_rows(false, state, tally)?;
        let enough = if body.nodes() <= SMALL { ENOUGH_OF_SMALL } else { ENOUGH };
        let mut last = f64::INFINITY;
        while tally.refined < self.request.steps() && !tally.stopped {
            check(exec.progress)?;
            let energy = system.fit_pose(&body.hierarchy, &mut state.rows.pose, exec)?;
            if !energy.is_finite() {
                return Err(Error::Solver("the energy left the range of numbers".into()));
            }
            tally.refined += 1;
            self.pull_scattered(state);
            let is_done = tally.refined == self.request.steps() || last - energy < enough * energy;
            last = energy;
            stats = self.run_rows(is_done, state, tally)?;
            if is_done {
                break;
            }
        }
        exec.progress.begin_pass("store");
        store(posed, state, exec.pool);
        if !is_warm {
            state.release_start();
        }
        Ok(stats)
    }

    /// Takes the pose over into the order of the solver's rows.
    fn load_rows(&self, fit: &RotationFit<'_>, posed: &PosedHandles, state: &mut SolveState) {
        let SolveState { rows, x, .. } = state;
        rows.take_over(self.body, self.handles, x, self.exec.pool);
        rows.center = posed.center;
        let vertices = self.body.hierarchy.row_vertices();
        let PoseRows { rows, open, .. } = &mut rows.pose;
        open.resize(rows.len(), false);
        self.exec.pool.install(|| {
            let rows = rows.par_iter_mut().zip(open).zip(vertices).with_min_len(4096);
            rows.filter(|(_, node)| **node != NO_NODE)
                .for_each(|((row, open), &node)| {
                    row.set_map(&posed.frames[node as usize]);
                    *open = fit.is_open(node as usize);
                });
        });
    }

    /// Ties and soft pulls, which depend on frames.
    fn pull_scattered(&self, state: &mut SolveState) {
        fill_scattered(self.handles, self.body, self.request.transforms, &mut state.rows);
    }

    /// Solves in the order of the solver's rows: one iteration, or with `is_last` to what the request asks for.
    fn run_rows(&self, is_last: bool, state: &mut SolveState, tally: &mut SolveTally<'_>) -> Result<SolveStats, Error> {
        let before = tally.iterations;
        let SolveState { rows, workspace, .. } = state;
        rows.pose.remember = false;
        rows.pose.show_positions(self.exec.pool);
        let stats = self
            .handles
            .positions
            .system
            .pose_equations(&self.body.hierarchy)
            .solve(&mut rows.pose, self.criteria(), workspace, self.exec, &mut |done| {
                self.report_cycle(done, before, tally);
                match tally.stopped || !is_last {
                    true => SolveControl::Stop,
                    false => SolveControl::Continue,
                }
            })?;
        tally.iterations += stats.iterations;
        Ok(stats)
    }
}

/// Gives the solution back in the order of nodes, around the centre, with frames and with what fits have added to the first pass's
/// rotations, which `posed.frames` has before.
fn store(posed: &mut PosedHandles, state: &mut SolveState, pool: &Pool) {
    let SolveState { x, extra, rows, .. } = state;
    let nodes = posed.frames.len();
    x.resize(3 * nodes, 0.0);
    extra.resize(nodes, [0.0; 4]);
    let solved = &*rows;
    pool.install(|| {
        let nodes = x
            .as_chunks_mut::<3>()
            .0
            .par_iter_mut()
            .zip(&mut posed.frames)
            .zip(extra);
        let nodes = nodes.zip(&solved.row_of).with_min_len(4096);
        nodes.for_each(|(((x, frame), extra), &row)| {
            let (row, [a, b, c, _]) = (&solved.pose.rows[row as usize], solved.pose.x[row as usize]);
            *x = [a, b, c];
            let first = std::mem::replace(frame, row.map());
            *extra = (rotation_of(frame) * rotation_of(&first).inverse()).to_array();
        });
    });
    rows.let_go();
}

/// The rotation of a frame without scales.
fn rotation_of(frame: &LocalFrame) -> Quat {
    Quat::from_mat3(&Mat3::from_cols_array(frame))
}
