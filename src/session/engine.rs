//! What a session needs of the thing that deforms its model.
//!
//! The one real engine is [`Workbench`]; the seam exists so that the rules of sessions and streams can be tested with
//! an engine whose every cycle the test controls.

use crate::asset::{FileSet, Format, WrittenFiles};
use crate::exec::Exec;
use crate::job::frames::Shader;
use crate::job::{self, EditOrder, EditOutcome, Limits, Mode, Poses, Settings, Solved, Trail, Watch, Workbench, pb};
use glam::DVec3;
use std::sync::Arc;

/// One model with everything derived from it. Calls come from compute threads, one at a time.
///
/// The contract is that of [`Workbench`]: a call that fails changes nothing, and a [`Mode::Commit`] solve depends on
/// nothing but model, handles, poses and settings.
pub trait Engine: Send + 'static {
    /// What a session answers about model, solver and handles.
    fn facts(&self) -> pb::Session;
    /// Positions at rest, one per render vertex.
    fn rest(&self) -> Arc<Vec<DVec3>>;
    /// Length of the bounding box's diagonal.
    fn diagonal(&self) -> f64;
    /// Bytes held.
    fn bytes(&self) -> u64;
    /// Bytes that the engine may hold after what is asked of it next.
    fn limit_memory(&mut self, _bytes: u64) {}
    /// Format of the model's files.
    fn format(&self) -> Format;
    /// Replaces the handles.
    fn set_handles(&mut self, request: &pb::SetHandlesRequest, exec: &Exec<'_>) -> Result<(), job::Error>;
    /// The poses that the handles in force came with.
    fn initial_poses(&self) -> Poses;
    /// `poses` with those that `change` names replaced.
    fn posed(&self, poses: &Poses, change: &pb::Pose) -> Result<Poses, job::Error>;
    /// Solves a pose.
    fn solve(
        &mut self,
        poses: &Poses,
        settings: &Settings,
        mode: Mode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&Watch<'_>) -> bool,
    ) -> Result<Solved, job::Error>;
    /// How far a shape is from the rest shape, with what `output` asks for beside; `None` when the engine measures
    /// nothing.
    fn measure(
        &self,
        _positions: &[DVec3],
        _output: &pb::Output,
        _exec: &Exec<'_>,
    ) -> Result<Option<pb::Quality>, job::Error> {
        Ok(None)
    }
    /// The state that edits have left the engine in; `None` when it knows no edits.
    fn trail(&self) -> Option<Trail> {
        None
    }
    /// Goes to the state that an earlier [`Engine::trail`] named; without handles then.
    fn retrace(&mut self, _trail: &Trail, _exec: &Exec<'_>) -> Result<(), job::Error> {
        Ok(())
    }
    /// Whether all is known of a shape that an edit needs; if not, a commit that makes it again tells.
    fn remembers(&self, _shape: &Arc<Vec<DVec3>>) -> bool {
        true
    }
    /// Carries out an edit and sets the handles that are left.
    fn edit(&mut self, order: &EditOrder<'_>, _exec: &Exec<'_>) -> Result<EditOutcome, job::Error> {
        Err(job::Error::Unimplemented(format!(
            "the edit {}",
            job::edit_name(order.request)
        )))
    }
    /// Writes the model with new positions.
    fn write(&self, positions: &[DVec3], format: Format) -> Result<WrittenFiles, job::Error>;
    /// What makes normals and tangents of a deformed shape.
    fn shader(&self) -> Shader;
}

/// Opens engines on models.
pub trait Opener: Send + Sync + 'static {
    /// Reads a model and builds everything derived from it, reporting stages to `progress`.
    fn open(
        &self,
        files: FileSet,
        create: &pb::CreateOptions,
        limits: &Limits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, job::Error>;
}

/// Opens a [`Workbench`].
#[derive(Debug, Clone, Copy, Default)]
pub struct OpenWorkbench;

impl Opener for OpenWorkbench {
    fn open(
        &self,
        files: FileSet,
        create: &pb::CreateOptions,
        limits: &Limits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, job::Error> {
        Ok(Box::new(Workbench::open(files, create, limits, exec)?))
    }
}

impl Engine for Workbench {
    fn facts(&self) -> pb::Session {
        Self::facts(self)
    }

    fn rest(&self) -> Arc<Vec<DVec3>> {
        Arc::clone(Self::rest(self))
    }

    fn diagonal(&self) -> f64 {
        Self::diagonal(self)
    }

    fn bytes(&self) -> u64 {
        Self::bytes(self)
    }

    fn limit_memory(&mut self, bytes: u64) {
        Self::limit_memory(self, bytes);
    }

    fn format(&self) -> Format {
        self.model().format
    }

    fn set_handles(&mut self, request: &pb::SetHandlesRequest, exec: &Exec<'_>) -> Result<(), job::Error> {
        Self::set_handles(self, request, exec)
    }

    fn initial_poses(&self) -> Poses {
        Self::initial_poses(self)
    }

    fn posed(&self, poses: &Poses, change: &pb::Pose) -> Result<Poses, job::Error> {
        Self::posed(self, poses, change)
    }

    fn solve(
        &mut self,
        poses: &Poses,
        settings: &Settings,
        mode: Mode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&Watch<'_>) -> bool,
    ) -> Result<Solved, job::Error> {
        Self::solve(self, poses, settings, mode, exec, watch)
    }

    fn measure(
        &self,
        positions: &[DVec3],
        output: &pb::Output,
        exec: &Exec<'_>,
    ) -> Result<Option<pb::Quality>, job::Error> {
        Self::measure(self, positions, output, exec).map(Some)
    }

    fn trail(&self) -> Option<Trail> {
        Some(Self::trail(self))
    }

    fn retrace(&mut self, trail: &Trail, exec: &Exec<'_>) -> Result<(), job::Error> {
        Self::retrace(self, trail, exec)
    }

    fn remembers(&self, shape: &Arc<Vec<DVec3>>) -> bool {
        Self::remembers(self, shape)
    }

    fn edit(&mut self, order: &EditOrder<'_>, exec: &Exec<'_>) -> Result<EditOutcome, job::Error> {
        Self::edit(self, order, exec)
    }

    fn write(&self, positions: &[DVec3], format: Format) -> Result<WrittenFiles, job::Error> {
        Self::write(self, positions, format)
    }

    fn shader(&self) -> Shader {
        Shader::of(self.geometry(), self.rest())
    }
}
