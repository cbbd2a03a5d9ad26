//! One group of columns and everything that iterating it needs: when a solve stops, its outcome, and the report that the
//! caller receives after every iteration; and the vectors that solves share.

use crate::lanes::{Lanes, WIDTH, WideLanes, resize_untouched};
use crate::options::SolveMethod;
use crate::solve::cycle::{CoarseVectors, MultigridCycle};
use crate::solve::patches::AffinePatches;
use crate::solve::problem::ColumnGroup;
use crate::solve::solution_subspace::SolutionSubspace;
use crate::solve::sweep::LaneDots;
use pliant_exec::pool::Pool;
use std::ops::Range;

/// One group of columns under iteration.
pub(crate) struct GroupSolve<'a, 'w> {
    pub(crate) problem: ColumnGroup<'a>,
    pub(crate) cycle: MultigridCycle<'a>,
    pub(crate) pool: &'a Pool,
    pub(crate) criteria: StoppingCriteria,
    pub(crate) workspace: &'w mut Workspace,
    /// The caller's x, for snapshots.
    pub(crate) caller: &'w [f64],
    /// True if x is 0 on free rows at first, which makes the first residual cheap.
    pub(crate) from_zero: bool,
    /// What earlier poses of the same system came to, and this one is to add to.
    pub(crate) recalled: Option<&'w mut SolutionSubspace>,
    /// What cycles have come to; `None` until they have reached a solution, or where none was needed.
    pub(crate) reached: Option<ReachedByCycles>,
    /// The residual that `workspace` holds: given, iterations go on from it; after a solve without iterations, what is left.
    pub(crate) left: Option<LeftResidual>,
}

/// Norms of a residual b − A x that a solve has left, column by column.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LeftResidual {
    /// Squared.
    pub(crate) squares: WideLanes,
    /// Of b.
    pub(crate) reference: WideLanes,
}

/// A solution that cycles have reached.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReachedByCycles {
    /// By what its residual is multiplied in the workspace.
    pub(crate) scale: WideLanes,
    /// What a vertex was moved by at most.
    pub(crate) moved: f64,
    /// The relative residual before.
    pub(crate) from_relative: f64,
}

/// When a solve stops. All criteria that are given must hold.
#[derive(Debug, Clone, Copy)]
pub struct StoppingCriteria {
    /// Largest relative residual of any column, as [`SolveOptions::tolerance`](crate::SolveOptions::tolerance).
    pub tolerance: Option<f64>,
    /// Largest estimated distance from the exact solution, as [`SolveOptions::max_error`](crate::SolveOptions::max_error).
    pub max_error: Option<f64>,
    /// Most iterations.
    pub max_iterations: usize,
}

impl StoppingCriteria {
    /// True if all criteria that were given hold, and at least one was.
    pub(crate) fn hold(&self, relative: &[f64], max_error: f64) -> bool {
        let residual = relative.iter().all(|r| self.tolerance.is_none_or(|t| *r <= t));
        let error = self.max_error.is_none_or(|m| max_error <= m);
        residual && error && (self.tolerance.is_some() || self.max_error.is_some())
    }

    /// The largest part that residual and error are of what is allowed.
    pub(crate) fn nearness(&self, relative: &[f64], max_error: f64) -> f64 {
        let worst = relative.iter().fold(0.0f64, |a, &b| a.max(b));
        let residual = self.tolerance.map_or(0.0, |t| worst / t);
        self.max_error.map_or(residual, |m| residual.max(max_error / m))
    }

    /// True if a column at this relative residual needs no more iterations, whatever the others need.
    pub(crate) fn rests(&self, relative: f64) -> bool {
        self.max_error.is_none() && self.tolerance.is_some_and(|t| relative <= t)
    }
}

/// What became of a group of columns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GroupOutcome {
    pub(crate) iterations: usize,
    pub(crate) relative: WideLanes,
    pub(crate) max_error: f64,
    pub(crate) factor: f64,
    pub(crate) method: SolveMethod,
    pub(crate) stopped: bool,
    pub(crate) converged: bool,
}

impl GroupOutcome {
    pub(crate) fn new(method: SolveMethod) -> Self {
        Self {
            iterations: 0,
            relative: [0.0; WIDTH],
            max_error: f64::INFINITY,
            factor: 0.0,
            method,
            stopped: false,
            converged: false,
        }
    }
}

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

/// Vectors that a solve needs; reuse it and solves of the same size allocate next to nothing.
///
/// It belongs to no hierarchy: one workspace can serve systems of any size, one solve at a time.
#[derive(Debug, Default)]
pub struct Workspace {
    /// The solution so far, in row order.
    pub(crate) x: Vec<WideLanes>,
    pub(crate) fine: FineVectors,
    pub(crate) coarse: Vec<CoarseVectors>,
    pub(crate) patches: Vec<AffinePatches>,
    /// Reduction of the residual by each iteration of the present solve, slowest column.
    pub(crate) history: Vec<f64>,
    /// Vectors in double precision for the direct method and the fallback.
    pub(crate) wide: [Vec<WideLanes>; 3],
    /// Solves so far, to detect whether the residual of an earlier one was overwritten.
    pub(crate) solves: u64,
}

/// Single-precision vectors of the outer iteration on the finest level.
#[derive(Debug, Default)]
pub(crate) struct FineVectors {
    /// Residual.
    pub(crate) r: Vec<Lanes>,
    /// Preconditioned residual.
    pub(crate) z: Vec<Lanes>,
    /// What A z is made from, and scratch on the way there.
    pub(crate) t: Vec<Lanes>,
    /// Correction to the solution.
    pub(crate) e: Vec<Lanes>,
    /// Residual and correction before the last step. Their differences to the present ones are that step and A times
    /// it: the search direction.
    pub(crate) last_r: Vec<Lanes>,
    pub(crate) last_e: Vec<Lanes>,
    pub(crate) partials: Vec<LaneDots>,
}

impl FineVectors {
    pub(crate) fn resize(&mut self, rows: usize) {
        for v in [
            &mut self.r,
            &mut self.z,
            &mut self.t,
            &mut self.e,
            &mut self.last_r,
            &mut self.last_e,
        ] {
            resize_untouched(v, rows);
        }
    }
}

impl Workspace {
    /// Lets go of what only starts by full multigrid and solves in double precision need.
    pub fn release_start(&mut self) {
        self.patches = Vec::new();
        self.wide = Default::default();
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        let f = &self.fine;
        let lanes: usize = [&f.r, &f.z, &f.t, &f.e, &f.last_r, &f.last_e]
            .iter()
            .map(|v| v.capacity())
            .sum();
        let wide = self.x.capacity() + self.wide.iter().map(Vec::capacity).sum::<usize>();
        let coarse: usize = self.coarse.iter().map(CoarseVectors::byte_size).sum();
        let patches: usize = self.patches.iter().map(AffinePatches::byte_size).sum();
        16 * (lanes + 3 * f.partials.capacity()) + 32 * wide + coarse + patches + 8 * self.history.capacity()
    }
}
