//! What a session needs of the thing that deforms its model.
//!
//! The one real engine is [`Deformer`]; the seam exists so that the rules of sessions and streams can be tested with
//! an engine whose every cycle the test controls.

use crate::asset::{FileSet, Format, WrittenFiles};
use crate::engine::Shader;
use crate::engine::{
    Deformer, DeformerLimits, EditCommand, EditOutcome, HandlePoses, SolveMode, SolveSettings, SolveUpdate,
    SolvedShape, TopologyState,
};
use crate::exec::Exec;
use crate::wire;
use crate::wire::pb;
use glam::DVec3;
use std::sync::Arc;

/// One model with everything derived from it. Calls come from compute threads, one at a time.
///
/// The contract is that of [`Deformer`]: a call that fails changes nothing, and a [`SolveMode::Commit`] solve depends on
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
    fn set_handles(&mut self, request: &pb::SetHandlesRequest, exec: &Exec<'_>) -> Result<(), wire::Error>;
    /// The poses that the handles in force came with.
    fn initial_poses(&self) -> HandlePoses;
    /// `poses` with those that `change` names replaced.
    fn posed(&self, poses: &HandlePoses, change: &pb::Pose) -> Result<HandlePoses, wire::Error>;
    /// Solves a pose.
    fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<SolvedShape, wire::Error>;
    /// How far a shape is from the rest shape, with what `output` asks for beside; `None` when the engine measures
    /// nothing.
    fn measure(
        &self,
        _positions: &[DVec3],
        _output: &pb::Output,
        _exec: &Exec<'_>,
    ) -> Result<Option<pb::Quality>, wire::Error> {
        Ok(None)
    }
    /// The state that edits have left the engine in; `None` when it knows no edits.
    fn trail(&self) -> Option<TopologyState> {
        None
    }
    /// Goes to the state that an earlier [`Engine::trail`] named; without handles then.
    fn retrace(&mut self, _trail: &TopologyState, _exec: &Exec<'_>) -> Result<(), wire::Error> {
        Ok(())
    }
    /// Whether all is known of a shape that an edit needs; if not, a commit that makes it again tells.
    fn remembers(&self, _shape: &Arc<Vec<DVec3>>) -> bool {
        true
    }
    /// Carries out an edit and sets the handles that are left.
    fn edit(&mut self, order: &EditCommand<'_>, _exec: &Exec<'_>) -> Result<EditOutcome, wire::Error> {
        Err(wire::Error::Unimplemented(format!(
            "the edit {}",
            wire::edit_kind_name(order.edit.kind())
        )))
    }
    /// Writes the model with new positions.
    fn write(&self, positions: &[DVec3], format: Format) -> Result<WrittenFiles, wire::Error>;
    /// What makes normals and tangents of a deformed shape.
    fn shader(&self) -> Shader;
}

/// Opens engines on models.
pub trait EngineOpener: Send + Sync + 'static {
    /// Reads a model and builds everything derived from it, reporting stages to `progress`.
    fn open(
        &self,
        files: FileSet,
        create: &pb::CreateOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, wire::Error>;
}

/// Opens a [`Deformer`].
#[derive(Debug, Clone, Copy, Default)]
pub struct OpenDeformer;

impl EngineOpener for OpenDeformer {
    fn open(
        &self,
        files: FileSet,
        create: &pb::CreateOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Box<dyn Engine>, wire::Error> {
        Ok(Box::new(Deformer::open(
            files,
            &wire::open_options(create)?,
            limits,
            exec,
        )?))
    }
}

impl Engine for Deformer {
    fn facts(&self) -> pb::Session {
        wire::session_message(&Self::facts(self))
    }

    fn rest(&self) -> Arc<Vec<DVec3>> {
        Arc::clone(Self::rest(self))
    }

    fn diagonal(&self) -> f64 {
        Self::diagonal(self)
    }

    fn bytes(&self) -> u64 {
        self.byte_size()
    }

    fn limit_memory(&mut self, bytes: u64) {
        Self::limit_memory(self, bytes);
    }

    fn format(&self) -> Format {
        self.model().format
    }

    fn set_handles(&mut self, request: &pb::SetHandlesRequest, exec: &Exec<'_>) -> Result<(), wire::Error> {
        Ok(Self::set_handles(self, wire::handle_set(request)?, exec)?)
    }

    fn initial_poses(&self) -> HandlePoses {
        Self::initial_poses(self)
    }

    fn posed(&self, poses: &HandlePoses, change: &pb::Pose) -> Result<HandlePoses, wire::Error> {
        wire::change_poses(self, poses, change)
    }

    fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<SolvedShape, wire::Error> {
        Ok(Self::solve(self, poses, settings, mode, exec, watch)?)
    }

    fn measure(
        &self,
        positions: &[DVec3],
        output: &pb::Output,
        exec: &Exec<'_>,
    ) -> Result<Option<pb::Quality>, wire::Error> {
        let quality = Self::measure(self, positions, output.self_intersections, exec)?;
        Ok(Some(wire::quality_message(&quality)))
    }

    fn trail(&self) -> Option<TopologyState> {
        Some(self.topology_state())
    }

    fn retrace(&mut self, trail: &TopologyState, exec: &Exec<'_>) -> Result<(), wire::Error> {
        Ok(self.restore_topology(trail, exec)?)
    }

    fn remembers(&self, shape: &Arc<Vec<DVec3>>) -> bool {
        Self::remembers(self, shape)
    }

    fn edit(&mut self, order: &EditCommand<'_>, exec: &Exec<'_>) -> Result<EditOutcome, wire::Error> {
        Ok(Self::edit(self, order, exec)?)
    }

    fn write(&self, positions: &[DVec3], format: Format) -> Result<WrittenFiles, wire::Error> {
        Ok(Self::write(self, positions, format)?)
    }

    fn shader(&self) -> Shader {
        Shader::from_geometry(self.geometry(), self.rest())
    }
}
