//! One group of columns and everything that iterating it needs.

use crate::pool::Pool;
use crate::solve::criteria::Criteria;
use crate::solve::cycle::Cycle;
use crate::solve::problem::Problem;
use crate::solve::workspace::Workspace;

/// One group of columns under iteration.
pub(crate) struct Outer<'a, 'w> {
    pub(crate) problem: Problem<'a>,
    pub(crate) cycle: Cycle<'a>,
    pub(crate) pool: &'a Pool,
    pub(crate) criteria: Criteria,
    pub(crate) workspace: &'w mut Workspace,
    /// The caller's x, for snapshots.
    pub(crate) caller: &'w [f64],
    /// True if x is 0 on free rows at first, which makes the first residual cheap.
    pub(crate) from_zero: bool,
}
