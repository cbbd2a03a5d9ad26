//! What the caller is shown after every iteration, and its answer.

use std::ops::Range;

use crate::lanes::{Lanes, WideLanes};
use crate::solve::problem::ColumnGroup;

/// Where a solve stands after one iteration; handed to the caller's `watch`.
#[derive(Debug)]
pub struct IterationReport<'a> {
    /// Iterations done for these columns, from 1.
    pub index: usize,
    /// The columns that are being iterated (columns are solved in groups of four).
    pub columns: Range<usize>,
    /// Relative residual, the largest of these columns.
    pub residual: f64,
    /// Estimate of the largest distance of any vertex from the exact solution, in the units of `x`. From the second
    /// iteration on it is usually between the true distance and three times that, rarely less than 0.7 of it; where
    /// few vertices hold many it can be ten times too large at first.
    pub max_error: f64,
    pub(crate) snapshot: SolutionSnapshot<'a>,
}

impl IterationReport<'_> {
    /// Writes the present solution, all vertices and columns, row-major as `x` of the solve. Fixed rows are copied
    /// bit for bit, and left alone where a pose is solved; columns whose turn has not come hold what `x` held.
    ///
    /// # Panics
    /// If `out` is not as long as the solve's `x`.
    pub fn copy_to(&self, out: &mut [f64]) {
        self.snapshot.copy_to(out);
    }
}

/// The answer of `watch`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolveControl {
    /// Go on until the criteria hold.
    Continue,
    /// Accept the present solution.
    Stop,
}

/// The solution at one moment.
pub(crate) struct SolutionSnapshot<'a> {
    pub(crate) problem: ColumnGroup<'a>,
    pub(crate) x: &'a [WideLanes],
    /// A correction that x lacks, and its unit per column.
    pub(crate) e: Option<(&'a [Lanes], WideLanes)>,
    pub(crate) caller: &'a [f64],
}

impl SolutionSnapshot<'_> {
    pub(crate) fn copy_to(&self, out: &mut [f64]) {
        // The given values of a pose are its owner's.
        if !self.caller.is_empty() {
            out.copy_from_slice(self.caller);
        }
        self.problem.store(self.x, self.e, out);
    }
}

impl std::fmt::Debug for SolutionSnapshot<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Snapshot({} rows)", self.x.len())
    }
}

/// Called after every iteration.
pub(crate) type IterationWatcher<'a> = dyn FnMut(&IterationReport<'_>) -> SolveControl + 'a;
