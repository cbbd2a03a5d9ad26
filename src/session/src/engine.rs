//! What a session needs of the engine of its model.
//!
//! The one real engine is [`Deformer`]; the trait exists so that tests of sessions and streams can use an engine whose every cycle they
//! control: how many cycles a solve takes, and what each of them sees, is exact there. It has what such an engine does as well; what
//! only a deformer does is asked of that.

use glam::DVec3;
use pliant_asset::{FileSet, Format, WrittenFiles};
use pliant_core::engine::{
    Deformer, DeformerFacts, DeformerLimits, Error, HandlePose, HandlePoses, HandleSet, ModelShape, OpenOptions,
    Shader, SolveMode, SolveSettings, SolveUpdate,
};
use pliant_exec::Exec;

/// One model with everything derived from it. Calls come from compute threads, one at a time.
///
/// The contract is that of [`Deformer`]: a call that fails changes nothing, and a [`SolveMode::Commit`] solve depends on
/// nothing but model, handles, poses and settings.
pub trait Engine: Send + 'static {
    /// The deformer that it is; `None` of an engine that neither edits nor measures, carries or animates anything.
    fn deformer(&mut self) -> Option<&mut Deformer> {
        None
    }
    /// The facts of model, solver and handles.
    fn facts(&self) -> DeformerFacts;
    /// The rest shape.
    fn rest_shape(&self) -> ModelShape;
    /// Length of the bounding box's diagonal.
    fn diagonal(&self) -> f64;
    /// Bytes held.
    fn byte_size(&self) -> u64;
    /// Format of the model's files.
    fn format(&self) -> Format;
    /// Replaces the handles.
    fn set_handles(&mut self, handles: &HandleSet, exec: &Exec<'_>) -> Result<(), Error>;
    /// The poses that the handles in force came with.
    fn initial_poses(&self) -> HandlePoses;
    /// `poses` with those that `changes` names replaced.
    fn change_poses(&self, poses: &HandlePoses, changes: &[(String, HandlePose)]) -> Result<HandlePoses, Error>;
    /// Solves a pose.
    fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error>;
    /// Writes the model with new positions.
    fn write(&self, positions: &[DVec3], format: Format, exec: &Exec<'_>) -> Result<WrittenFiles, Error>;
    /// What makes normals and tangents of a deformed shape.
    fn shader(&self) -> Shader;
}

/// Opens engines on models.
pub trait EngineOpener: Send + Sync + 'static {
    /// Reads a model and builds everything derived from it, reporting stages to `progress`.
    fn open(
        &self,
        files: FileSet,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, Error>;
}

/// Opens a [`Deformer`].
#[derive(Debug, Clone, Copy, Default)]
pub struct OpenDeformer;

impl EngineOpener for OpenDeformer {
    fn open(
        &self,
        files: FileSet,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, Error> {
        Ok(Box::new(Deformer::open(files, options, limits, exec)?))
    }
}

impl Engine for Deformer {
    fn deformer(&mut self) -> Option<&mut Deformer> {
        Some(self)
    }

    fn facts(&self) -> DeformerFacts {
        Self::facts(self)
    }

    fn rest_shape(&self) -> ModelShape {
        Self::rest_shape(self)
    }

    fn diagonal(&self) -> f64 {
        Self::diagonal(self)
    }

    fn byte_size(&self) -> u64 {
        Self::byte_size(self)
    }

    fn format(&self) -> Format {
        self.model().format
    }

    fn set_handles(&mut self, handles: &HandleSet, exec: &Exec<'_>) -> Result<(), Error> {
        Self::set_handles(self, handles, exec)
    }

    fn initial_poses(&self) -> HandlePoses {
        Self::initial_poses(self)
    }

    fn change_poses(&self, poses: &HandlePoses, changes: &[(String, HandlePose)]) -> Result<HandlePoses, Error> {
        Self::change_poses(
            self,
            poses,
            changes.iter().map(|(id, pose)| (id.as_str(), pose.clone())),
        )
    }

    fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error> {
        Self::solve(self, poses, settings, mode, exec, watch)
    }

    fn write(&self, positions: &[DVec3], format: Format, exec: &Exec<'_>) -> Result<WrittenFiles, Error> {
        Self::write(self, positions, format, exec)
    }

    fn shader(&self) -> Shader {
        Shader::from_geometry(self.geometry(), self.rest())
    }
}
