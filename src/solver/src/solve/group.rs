//! One group of columns and everything that iterating it needs.

use crate::lanes::WideLanes;
use crate::pool::Pool;
use crate::solve::criteria::StoppingCriteria;
use crate::solve::cycle::MultigridCycle;
use crate::solve::problem::ColumnGroup;
use crate::solve::recalled::RecalledSteps;
use crate::solve::workspace::Workspace;

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
    pub(crate) recalled: Option<&'w mut RecalledSteps>,
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
