//! A system ready to solve, and the terms under which it is measured.

use super::problem::CompressedRows;
use crate::failure::LoadtestFailure;
use crate::measurements::{RunTimes, time_best_of, time_once};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::solver::{
    BuildOptions, Constraints, Hierarchy, IterationReport, LinearSystem, SolveControl, SolveOptions, SolveStats,
    WeightedGraph, Workspace,
};
use std::time::Instant;

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

/// A ready system is a hierarchy with constraints and the vectors of a solve, ready to solve.
pub(super) struct ReadySystem<'a> {
    pub hierarchy: Hierarchy,
    pub system: LinearSystem,
    pub workspace: Workspace,
    pub terms: &'a BenchTerms,
}

impl<'a> ReadySystem<'a> {
    /// Builds the hierarchy of a graph, and constrains it.
    pub fn build(
        graph: &WeightedGraph<'_>,
        options: &BuildOptions,
        constraints: &Constraints<'_>,
        terms: &'a BenchTerms,
    ) -> Result<Self, LoadtestFailure> {
        let exec = Exec::new(&terms.pool, &Silent);
        let hierarchy = Hierarchy::build(graph, options, &exec).map_err(solver_failure)?;
        let system = hierarchy.constrain(constraints, &terms.pool).map_err(solver_failure)?;
        Ok(Self {
            hierarchy,
            system,
            workspace: Workspace::default(),
            terms,
        })
    }

    /// Solves for so many columns, and calls `watch` after each iteration.
    pub fn solve_columns(
        &mut self,
        columns: usize,
        rhs: &[f64],
        x: &mut [f64],
        options: &SolveOptions<'_>,
        watch: &mut dyn FnMut(&IterationReport<'_>),
    ) -> Result<SolveStats, LoadtestFailure> {
        let exec = Exec::new(&self.terms.pool, &Silent);
        let equations = self.system.equations(&self.hierarchy, columns, rhs);
        let mut watch = |iteration: &IterationReport<'_>| {
            watch(iteration);
            SolveControl::Continue
        };
        let solved = equations.solve(x, options, &mut self.workspace, &exec, &mut watch);
        solved.map_err(solver_failure)
    }

    /// Solves for three columns.
    pub fn solve(
        &mut self,
        rhs: &[[f64; 3]],
        x: &mut [[f64; 3]],
        options: &SolveOptions<'_>,
    ) -> Result<SolveStats, LoadtestFailure> {
        self.solve_columns(3, rhs.as_flattened(), x.as_flattened_mut(), options, &mut |_| {})
    }

    /// Solves several times, each time from what `start` makes. Returns the last result and the times.
    pub fn solve_and_time(
        &mut self,
        rhs: &[[f64; 3]],
        start: impl FnMut() -> Vec<[f64; 3]>,
        options: &SolveOptions<'_>,
    ) -> Result<(Vec<[f64; 3]>, SolveStats, RunTimes), LoadtestFailure> {
        let repeat = self.terms.repeat;
        let solve = |mut x: Vec<[f64; 3]>| -> Result<_, LoadtestFailure> {
            let stats = self.solve(rhs, &mut x, options)?;
            Ok((x, stats))
        };
        let ((x, stats), times) = time_best_of(repeat, start, solve)?;
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

/// Bytes of a line of this process's status, 0 where there is none.
fn process_status(key: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix(key));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}

/// Bytes resident now.
pub(super) fn resident_bytes() -> u64 {
    process_status("VmRSS:")
}

/// Most bytes resident since [`reset_peak`], or since the start where that is not possible.
pub(super) fn peak_bytes() -> u64 {
    process_status("VmHWM:")
}

/// Resets the peak; false where the system does not allow it.
pub(super) fn reset_peak() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Measures the seconds of one work unit: the matrix times three columns on one thread, the fastest of at least 5 runs and as many as
/// fit 0.3 s (at most 40), after one that is not counted.
pub(super) fn measure_work_unit(matrix: &CompressedRows) -> f64 {
    let x: Vec<[f64; 3]> = (0..matrix.rows())
        .map(|i| [0, 1, 2].map(|c| 1.0 + ((3 * i + c) % 7) as f64))
        .collect();
    let mut y = vec![[0.0; 3]; matrix.rows()];
    matrix.multiply(&x, &mut y);
    let (mut best, start) = (f64::INFINITY, Instant::now());
    for run in 0..40 {
        if run >= 5 && start.elapsed().as_secs_f64() >= 0.3 {
            break;
        }
        let ((), seconds) = time_once(|| matrix.multiply(&x, &mut y));
        best = best.min(seconds);
        // The product must be wanted, or the compiler may leave it out.
        std::hint::black_box(&mut y);
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_sees_what_is_gone_again() {
        if !std::path::Path::new("/proc/self/status").exists() || !reset_peak() {
            println!("skipped: no /proc/self/status, or no way to reset the peak");
            return;
        }
        let before = peak_bytes();
        drop(std::hint::black_box(vec![1u8; 256 << 20]));
        assert!(peak_bytes() >= before + (128 << 20), "{before} {}", peak_bytes());
    }
}
