//! A system ready to solve, and the terms under which it is measured.

use crate::failure::LoadtestFailure;
use crate::shared::timing::{RunTimes, time_best_of};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::solver::{Hierarchy, LinearSystem, SolveControl, SolveOptions, SolveStats, Workspace};

/// Most iterations of a solve that must reach the limits of double precision.
const MOST_ITERATIONS: usize = 1000;

/// Relative residual of a solution that errors are measured from.
pub(super) const EXACT_RESIDUAL: f64 = 1e-11;

/// How things are measured.
pub(super) struct BenchTerms {
    /// Where the solver runs.
    pub pool: Pool,
    /// Most runs of what is timed.
    pub repeat: u32,
    /// Without solutions to the last digit.
    pub fast: bool,
}

/// A system ready to solve, with what solves share.
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
        residuals: Option<&mut Vec<f64>>,
    ) -> Result<SolveStats, LoadtestFailure> {
        let mut log = residuals;
        let (rhs, x) = (rhs.as_flattened(), x.as_flattened_mut());
        self.system
            .solve(
                &self.hierarchy,
                3,
                rhs,
                x,
                options,
                workspace,
                &Exec::new(&terms.pool, &Silent),
                &mut |iteration| {
                    if let Some(log) = log.as_deref_mut() {
                        log.push(iteration.residual);
                    }
                    SolveControl::Continue
                },
            )
            .map_err(solver_failure)
    }

    /// Solves several times, each from what `start` makes, and tells the last result and what one solve took.
    pub fn solve_and_time(
        &self,
        rhs: &[[f64; 3]],
        start: impl FnMut() -> Vec<[f64; 3]>,
        options: &SolveOptions<'_>,
        workspace: &mut Workspace,
        terms: &BenchTerms,
    ) -> Result<(Vec<[f64; 3]>, SolveStats, RunTimes), LoadtestFailure> {
        let solve = |mut x: Vec<[f64; 3]>| -> Result<_, LoadtestFailure> {
            let stats = self.solve(rhs, &mut x, options, workspace, terms, None)?;
            Ok((x, stats))
        };
        let ((x, stats), times) = time_best_of(terms.repeat, start, solve)?;
        Ok((x, stats, times))
    }
}

/// What the solver said when it could not.
pub(super) fn solver_failure(e: pliant::solver::Error) -> LoadtestFailure {
    LoadtestFailure::Server(format!("the solver solver_failure: {e}"))
}

/// Options of a solve to a relative residual.
pub(super) fn options_to_residual(tolerance: f64) -> SolveOptions<'static> {
    SolveOptions {
        tolerance: Some(tolerance),
        max_iterations: MOST_ITERATIONS,
        ..Default::default()
    }
}

/// The largest distance between rows.
pub(super) fn largest_distance(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let apart = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (a[c] - b[c]) * (a[c] - b[c])).sum::<f64>();
    a.iter().zip(b).map(apart).fold(0.0, f64::max).sqrt()
}
