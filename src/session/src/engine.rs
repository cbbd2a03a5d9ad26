//! What a session needs of the engine of its model.
//!
//! The one real engine is [`Deformer`]; the trait exists so that tests of sessions and streams can use an engine whose
//! every cycle they control.

use glam::DVec3;
use pliant_asset::{FileSet, Format, WrittenFiles};
use pliant_core::engine::{
    Animation, AnimationLimits, CarriedModel, ClipRequest, Deformer, DeformerFacts, DeformerLimits, DeformerWarning,
    EditCommand, EditOutcome, Error, HandlePose, HandlePoses, HandleSet, ModelShape, OpenOptions, QualityReport,
    Shader, ShapeId, SolveMode, SolveSettings, SolveUpdate, TopologyState,
};
use pliant_exec::Exec;
use pliant_mesh::carry::CarriedFrame;
use pliant_wire::edit_kind_name;

/// One model with everything derived from it. Calls come from compute threads, one at a time.
///
/// The contract is that of [`Deformer`]: a call that fails changes nothing, and a [`SolveMode::Commit`] solve depends on
/// nothing but model, handles, poses and settings.
pub trait Engine: Send + 'static {
    /// The facts of model, solver and handles.
    fn facts(&self) -> DeformerFacts;
    /// The rest shape.
    fn rest_shape(&self) -> ModelShape;
    /// Length of the bounding box's diagonal.
    fn diagonal(&self) -> f64;
    /// Bytes held.
    fn byte_size(&self) -> u64;
    /// Sets the bytes that the engine may hold after the next call.
    fn limit_memory(&mut self, _bytes: u64) {}
    /// Bytes of what [`Engine::release_memory`] drops.
    fn spare_bytes(&self) -> u64 {
        0
    }
    /// Drops the handles, and all that can be made again.
    fn release_memory(&mut self) {}
    /// Format of the model's files.
    fn format(&self) -> Format;
    /// Replaces the handles.
    fn set_handles(&mut self, handles: &HandleSet, exec: &Exec<'_>) -> Result<(), Error>;
    /// The poses that the handles in force came with.
    fn initial_poses(&self) -> HandlePoses;
    /// `poses` with those that `changes` names replaced.
    fn change_poses(&self, poses: &HandlePoses, changes: &[(String, HandlePose)]) -> Result<HandlePoses, Error>;
    /// What a user should know of `poses`.
    fn pose_warnings(&self, _poses: &HandlePoses) -> Vec<DeformerWarning> {
        Vec::new()
    }
    /// Solves a pose.
    fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error>;
    /// Whether the last pose of a drag has left something to do for [`Engine::settle`].
    fn is_worth_settling(&self) -> bool {
        false
    }
    /// Works ahead between two poses of a drag.
    fn settle(&mut self, _exec: &Exec<'_>) -> Result<(), Error> {
        Ok(())
    }
    /// How far a shape is from the rest shape, with the number of self-intersections when `count_crossings` asks for it;
    /// `None` when the engine measures nothing.
    fn measure(
        &self,
        _positions: &[DVec3],
        _count_crossings: bool,
        _exec: &Exec<'_>,
    ) -> Result<Option<QualityReport>, Error> {
        Ok(None)
    }
    /// The state that edits have left the engine in; `None` when it knows no edits.
    fn topology_state(&self) -> Option<TopologyState> {
        None
    }
    /// Goes to the state that an earlier [`Engine::topology_state`] named; without handles then.
    fn restore_topology(&mut self, _state: &TopologyState, _exec: &Exec<'_>) -> Result<(), Error> {
        Ok(())
    }
    /// Whether the engine has all that an edit needs of a shape; if not, it is solved again.
    fn remembers(&self, _shape: ShapeId) -> bool {
        true
    }
    /// Carries out an edit and sets the handles that are left.
    fn edit(&mut self, command: &EditCommand<'_>, _exec: &Exec<'_>) -> Result<EditOutcome, Error> {
        let name = edit_kind_name(command.edit.kind());
        Err(Error::Unimplemented(format!("the edit {name}")))
    }
    /// Writes the model with new positions.
    fn write(&self, positions: &[DVec3], format: Format, exec: &Exec<'_>) -> Result<WrittenFiles, Error>;
    /// Carries points of the rest space along with a shape.
    fn carry_points(
        &self,
        _positions: &[DVec3],
        _points: &[DVec3],
        _exec: &Exec<'_>,
    ) -> Result<Vec<CarriedFrame>, Error> {
        Err(Error::Unimplemented("carrying points".into()))
    }
    /// Carries another model along with a shape.
    fn carry_model(
        &self,
        _positions: &[DVec3],
        _passenger: CarriedModel,
        _exec: &Exec<'_>,
    ) -> Result<WrittenFiles, Error> {
        Err(Error::Unimplemented("carrying a model".into()))
    }
    /// Prepares an animation of the rest shape.
    fn prepare_animation(
        &self,
        _request: &ClipRequest,
        _limits: &AnimationLimits,
        _exec: &Exec<'_>,
    ) -> Result<Animation, Error> {
        Err(Error::Unimplemented("animating".into()))
    }
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
    fn pose_warnings(&self, poses: &HandlePoses) -> Vec<DeformerWarning> {
        self.pose_warnings(poses)
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

    fn limit_memory(&mut self, bytes: u64) {
        Self::limit_memory(self, bytes);
    }

    fn spare_bytes(&self) -> u64 {
        Self::spare_bytes(self)
    }

    fn release_memory(&mut self) {
        Self::release_memory(self);
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
        Self::change_poses(self, poses, changes.iter().map(|(id, pose)| (id.as_str(), *pose)))
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

    fn is_worth_settling(&self) -> bool {
        Self::is_worth_settling(self)
    }

    fn settle(&mut self, exec: &Exec<'_>) -> Result<(), Error> {
        Self::settle(self, exec)
    }

    fn measure(
        &self,
        positions: &[DVec3],
        count_crossings: bool,
        exec: &Exec<'_>,
    ) -> Result<Option<QualityReport>, Error> {
        Self::measure(self, positions, count_crossings, exec).map(Some)
    }

    fn topology_state(&self) -> Option<TopologyState> {
        Some(Self::topology_state(self))
    }

    fn restore_topology(&mut self, state: &TopologyState, exec: &Exec<'_>) -> Result<(), Error> {
        Self::restore_topology(self, state, exec)
    }

    fn remembers(&self, shape: ShapeId) -> bool {
        Self::remembers(self, shape)
    }

    fn edit(&mut self, command: &EditCommand<'_>, exec: &Exec<'_>) -> Result<EditOutcome, Error> {
        Self::edit(self, command, exec)
    }

    fn write(&self, positions: &[DVec3], format: Format, exec: &Exec<'_>) -> Result<WrittenFiles, Error> {
        Self::write(self, positions, format, exec)
    }

    fn carry_points(&self, positions: &[DVec3], points: &[DVec3], exec: &Exec<'_>) -> Result<Vec<CarriedFrame>, Error> {
        Self::carry_points(self, positions, points, exec)
    }

    fn carry_model(
        &self,
        positions: &[DVec3],
        passenger: CarriedModel,
        exec: &Exec<'_>,
    ) -> Result<WrittenFiles, Error> {
        Self::carry_model(self, positions, passenger, exec)
    }

    fn prepare_animation(
        &self,
        request: &ClipRequest,
        limits: &AnimationLimits,
        exec: &Exec<'_>,
    ) -> Result<Animation, Error> {
        Animation::prepare(self, request, limits, exec)
    }

    fn shader(&self) -> Shader {
        Shader::from_geometry(self.geometry(), self.rest())
    }
}
