//! A system ready to solve, and the terms under which it is measured.

use crate::failure::LoadtestFailure;
use crate::shared::timing::{RunTimes, time_best_of};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::solver::{Hierarchy, IterationReport, LinearSystem, SolveControl, SolveOptions, SolveStats, Workspace};

/// Most iterations of a solve that must reach the limits of double precision.
const MOST_ITERATIONS: usize = 1000;

/// Relative residual of a solution that errors are measured from.
pub(super) const EXACT_RESIDUAL: f64 = 1e-11;

/// Bench terms say how things are measured.
pub(super) struct BenchTerms {
    /// Where the solver runs.
    pub pool: Pool,
    /// Most runs of what is timed.
    pub repeat: u32,
    /// Without solutions to the last digit.
    pub fast: bool,
}

/// A ready system is a hierarchy with constraints, ready to solve.
pub(super) struct ReadySystem {
    pub hierarchy: Hierarchy,
    pub system: LinearSystem,
}

impl ReadySystem {
    /// Solves for three columns.
    pub fn solve(
        &self,
        rhs: &[[f64; 3]],
        x: &mut [[f64; 3]],
        options: &SolveOptions<'_>,
        workspace: &mut Workspace,
        terms: &BenchTerms,
    ) -> Result<SolveStats, LoadtestFailure> {
        let logged = self.solve_logged(rhs, x, options, workspace, terms);
        logged.map(|(stats, _)| stats)
    }

    /// Solves for three columns; also returns the residual of each iteration.
    pub fn solve_logged(
        &self,
        rhs: &[[f64; 3]],
        x: &mut [[f64; 3]],
        options: &SolveOptions<'_>,
        workspace: &mut Workspace,
        terms: &BenchTerms,
    ) -> Result<(SolveStats, Vec<f64>), LoadtestFailure> {
        let mut residuals = Vec::new();
        let mut watch = |iteration: &IterationReport<'_>| {
            residuals.push(iteration.residual);
            SolveControl::Continue
        };
        let (rhs, x) = (rhs.as_flattened(), x.as_flattened_mut());
        let exec = Exec::new(&terms.pool, &Silent);
        let solved = self
            .system
            .equations(&self.hierarchy, 3, rhs)
            .solve(x, options, workspace, &exec, &mut watch);
        Ok((solved.map_err(solver_failure)?, residuals))
    }

    /// Solves several times, each time from what `start` makes. Returns the last result and the times.
    pub fn solve_and_time(
        &self,
        rhs: &[[f64; 3]],
        start: impl FnMut() -> Vec<[f64; 3]>,
        options: &SolveOptions<'_>,
        workspace: &mut Workspace,
        terms: &BenchTerms,
    ) -> Result<(Vec<[f64; 3]>, SolveStats, RunTimes), LoadtestFailure> {
        let solve = |mut x: Vec<[f64; 3]>| -> Result<_, LoadtestFailure> {
            let stats = self.solve(rhs, &mut x, options, workspace, terms)?;
            Ok((x, stats))
        };
        let ((x, stats), times) = time_best_of(terms.repeat, start, solve)?;
        Ok((x, stats, times))
    }
}

/// Turns an error of the solver into a failure of the command.
pub(super) fn solver_failure(e: pliant::solver::Error) -> LoadtestFailure {
    LoadtestFailure::Server(format!("the solver failed: {e}"))
}

/// Makes the options of a solve to a relative residual.
pub(super) fn options_to_residual(tolerance: f64) -> SolveOptions<'static> {
    SolveOptions {
        tolerance: Some(tolerance),
        max_iterations: MOST_ITERATIONS,
        ..Default::default()
    }
}

/// Computes the largest distance between rows.
pub(super) fn largest_distance(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let apart = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (a[c] - b[c]) * (a[c] - b[c])).sum::<f64>();
    a.iter().zip(b).map(apart).fold(0.0, f64::max).sqrt()
}
