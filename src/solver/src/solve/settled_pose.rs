//! What a frame of a drag may leave to be done once it is out.
//!
//! Where earlier poses explain a pose well enough there is no iteration, and what is left of the residual adds up from frame to
//! frame until one of them needs a cycle and takes twice as long. Solved between frames, where a drag has time, it adds up no more.

use crate::build::hierarchy::Hierarchy;
use crate::constrain::system::LinearSystem;
use crate::error::Error;
use crate::exec::Exec;
use crate::solve::criteria::StoppingCriteria;
use crate::solve::iteration::SolveControl;
use crate::solve::pose::PoseRows;
use crate::solve::workspace::Workspace;

/// A pose is worth an iteration between frames from this part of what its solve allowed on: with less, iterations would come more
/// often than frames need them; with more, a frame would often need one before it can go out.
const WORTH_SETTLING: f64 = 0.3;

impl PoseRows {
    /// Whether the last solve, which needed no iteration, left enough for [`LinearSystem::settle_pose`] to be worth its time.
    pub fn is_worth_settling(&self) -> bool {
        (self.unsettled.as_ref()).is_some_and(|unsettled| unsettled.nearness > WORTH_SETTLING)
    }
}

impl LinearSystem {
    /// Takes one iteration on what the last [`LinearSystem::solve_pose`] has left of the pose, if that is worth it; with the same
    /// `workspace`, or nothing is done. The solution becomes better, and the next pose begins from it.
    ///
    /// # Errors
    /// As [`LinearSystem::solve_pose`]; after [`Error::Cancelled`] positions are still those of before.
    pub fn settle_pose(
        &self,
        hierarchy: &Hierarchy,
        pose: &mut PoseRows,
        (workspace, exec): (&mut Workspace, &Exec<'_>),
    ) -> Result<(), Error> {
        self.check_pose(hierarchy, pose)?;
        let Some(unsettled) = pose.unsettled.filter(|_| pose.is_worth_settling()) else {
            return Ok(());
        };
        if unsettled.solve != workspace.solves {
            pose.unsettled = None;
            return Ok(());
        }
        exec.check()?;
        let criteria = StoppingCriteria {
            tolerance: None,
            max_error: None,
            max_iterations: 1,
        };
        let job = (criteria, true, Some(unsettled.left));
        self.iterate_pose(hierarchy, pose, job, (workspace, exec), &mut |_| SolveControl::Stop)?;
        Ok(())
    }
}
