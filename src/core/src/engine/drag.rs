//! The short ways to a shape: a drag from pose to pose, a commit, an edit of the rest shape.

use super::Deformer;
use super::edit_command::{Edit, EditCommand, EditOutcome, EditedShape};
use super::error::Error;
use super::pose::{HandlePose, HandlePoses};
use super::settings::{SolveMode, SolveSettings};
use super::solve::SolvedShape;
use crate::exec::Exec;

/// A drag under way: every pose starts from the shape of the one before it.
pub struct Drag<'a> {
    deformer: &'a mut Deformer,
    settings: SolveSettings,
    poses: HandlePoses,
}

impl Drag<'_> {
    /// Solves for new poses of some handles; the others stay where they are.
    ///
    /// # Errors
    /// [`Error::Precondition`] without handles, [`Error::Invalid`] for the id of a handle that is not set,
    /// [`Error::Cancelled`].
    pub fn solve<'p>(
        &mut self,
        changes: impl IntoIterator<Item = (&'p str, HandlePose)>,
        exec: &Exec<'_>,
    ) -> Result<SolvedShape, Error> {
        self.poses = self.deformer.change_poses(&self.poses, changes)?;
        let mode = SolveMode::Drag;
        (self.deformer).solve(&self.poses, &self.settings, mode, exec, &mut |_| true)
    }

    /// Works ahead in idle time, so that the next pose is solved sooner; see [`Deformer::settle`].
    ///
    /// # Errors
    /// Those of [`Deformer::settle`].
    pub fn settle(&mut self, exec: &Exec<'_>) -> Result<(), Error> {
        self.deformer.settle(exec)
    }

    /// Returns the poses that the handles have now.
    pub fn poses(&self) -> &HandlePoses {
        &self.poses
    }
}

impl Deformer {
    /// Begins a drag from the poses that the handles came with.
    pub fn drag(&mut self, settings: &SolveSettings) -> Drag<'_> {
        Drag {
            poses: self.initial_poses(),
            settings: settings.clone(),
            deformer: self,
        }
    }

    /// Solves for poses of some handles, the others being where they were set. The bits of the shape depend on model,
    /// handles, poses and settings alone.
    ///
    /// # Errors
    /// Those of [`Deformer::change_poses`] and [`Deformer::solve`].
    pub fn commit<'p>(
        &mut self,
        changes: impl IntoIterator<Item = (&'p str, HandlePose)>,
        settings: &SolveSettings,
        exec: &Exec<'_>,
    ) -> Result<SolvedShape, Error> {
        let poses = self.change_poses(&self.initial_poses(), changes)?;
        self.solve(&poses, settings, SolveMode::Commit, exec, &mut |_| true)
    }

    /// Edits the rest shape. Regions that are given by place stay as they are; others become the list of the vertices that are left.
    ///
    /// # Errors
    /// Those of [`Deformer::edit`].
    pub fn edit_rest(&mut self, edit: &Edit, exec: &Exec<'_>) -> Result<EditOutcome, Error> {
        let (shape, poses) = (self.rest_shape(), self.initial_poses());
        let command = EditCommand {
            edit,
            on: EditedShape::Rest,
            shape: &shape,
            poses: &poses,
            settings: None,
        };
        self.edit(&command, exec)
    }
}
