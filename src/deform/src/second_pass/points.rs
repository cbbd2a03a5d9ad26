//! Points of the surface that holds pull, solved for again and again until nothing moves.
//!
//! Each solve goes as far as the majorization of the points lets it ([`PulledPoint`](crate::handles::PulledPoint)). Where they pull along
//! a plane alone that is little a time, so each goes on from beyond where the last one ended, as far as it came from the one
//! before (Nesterov's acceleration), and from the end itself where that was the wrong way.

use crate::error::Error;
use crate::pose::SolveStart;
use crate::second_pass::equations::PosedHandles;
use crate::second_pass::refine::RotationFit;
use crate::second_pass::state::SolveState;
use crate::solve::{PoseSolve, SolveTally};
use pliant_exec::progress::check;
use pliant_solver::{InitialGuess, SolveStats};

/// Solves at most.
const MOST: u32 = 60;
/// A solve that moves no node by more than this part of the diagonal is the last one.
const ENOUGH: f64 = 2e-6;

impl PoseSolve<'_> {
    /// Solves a shape that is to last on, until points of the surface are where their holds want them. A pose of a drag has one solve,
    /// and comes nearer with the poses that follow.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`].
    pub(crate) fn settle_points(
        &self,
        fit: Option<&RotationFit<'_>>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<Option<SolveStats>, Error> {
        if self.request.start == SolveStart::Warm {
            return Ok(None);
        }
        let pool = self.exec.pool;
        let mut turns = fit.map(|fit| fit.resume(&state.extra, pool));
        let mut before = state.x.clone();
        let (mut stats, mut run) = (None, 0u32);
        let enough = ENOUGH * self.body.diagonal / self.body.unit;
        for _ in 0..MOST {
            check(self.exec.progress)?;
            if tally.stopped {
                break;
            }
            let beyond = f64::from(run) / f64::from(run + 3);
            let start: Vec<f64> = (state.x.iter().zip(&before))
                .map(|(now, before)| now + beyond * (now - before))
                .collect();
            before = std::mem::replace(&mut state.x, start.clone());
            if let Some((fit, turns)) = fit.zip(turns.as_mut()) {
                *turns = fit.step(turns, &state.x, pool);
                posed.frames = fit.frames(turns, pool);
            }
            self.assemble(posed, state);
            stats = Some(self.run(&self.handles.positions, InitialGuess::Given, 0.0, state, tally)?);
            let (mut most, mut way) = (0.0f64, 0.0);
            for ((now, start), before) in state.x.iter().zip(&start).zip(&before) {
                most = most.max((now - before).abs());
                way += (start - now) * (now - before);
            }
            if most <= enough {
                break;
            }
            run = if way > 0.0 { 0 } else { run + 1 };
        }
        if let Some((fit, turns)) = fit.zip(turns.as_ref()) {
            state.extra = fit.extra(turns, pool);
        }
        Ok(stats)
    }
}
