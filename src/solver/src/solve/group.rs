//! One group of columns and everything that iterating it needs.

use crate::pool::Pool;
use crate::solve::criteria::StoppingCriteria;
use crate::solve::cycle::MultigridCycle;
use crate::solve::problem::ColumnGroup;
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
}
