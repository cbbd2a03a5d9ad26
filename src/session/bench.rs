//! An engine together with what it holds now, so that a piece of work that was given up half-way costs nothing but its
//! time: the next one brings the engine back to the handles that it needs.

use super::Engine;
use super::commits::Recipe;
use crate::engine::Shader;
use crate::engine::{
    EditCommand, EditOutcome, HandlePoses, SolveMode, SolveSettings, SolveUpdate, SolvedShape, TopologyState,
};
use crate::exec::Exec;
use crate::wire;
use crate::wire::pb;
use glam::DVec3;
use std::sync::Arc;

/// The engine of one session. Moves to the compute pool and back with every piece of work.
pub(super) struct Bench {
    /// The engine.
    pub engine: Box<dyn Engine>,
    loaded: Arc<pb::SetHandlesRequest>,
    shader: Option<Arc<Shader>>,
}

impl Bench {
    /// A fresh engine, without handles; `loaded` is the session's empty request.
    pub fn new(engine: Box<dyn Engine>, loaded: Arc<pb::SetHandlesRequest>) -> Self {
        Self {
            engine,
            loaded,
            shader: None,
        }
    }

    /// Makes `trail` the state that edits have left, and `handles` the ones in force.
    pub fn load(
        &mut self,
        trail: Option<&TopologyState>,
        handles: &Arc<pb::SetHandlesRequest>,
        exec: &Exec<'_>,
    ) -> Result<(), wire::Error> {
        self.go(trail, exec)?;
        if !Arc::ptr_eq(&self.loaded, handles) {
            self.engine.set_handles(handles, exec)?;
            self.loaded = Arc::clone(handles);
        }
        Ok(())
    }

    /// Makes `trail` the state that edits have left.
    pub fn go(&mut self, trail: Option<&TopologyState>, exec: &Exec<'_>) -> Result<(), wire::Error> {
        let Some(trail) = trail else { return Ok(()) };
        if self.engine.trail().is_some_and(|now| now.is_same(trail)) {
            return Ok(());
        }
        self.engine.retrace(trail, exec)?;
        self.forget();
        Ok(())
    }

    /// Edits the shape of the state named by `trail` and `handles`, for a commit. Until the commit is stored, `load` with
    /// the old ones goes back.
    pub fn edit(
        &mut self,
        trail: Option<&TopologyState>,
        handles: &Arc<pb::SetHandlesRequest>,
        order: &EditCommand<'_>,
        exec: &Exec<'_>,
    ) -> Result<EditOutcome, wire::Error> {
        self.load(trail, handles, exec)?;
        let outcome = self.engine.edit(order, exec)?;
        self.forget();
        Ok(outcome)
    }

    /// What was derived from the engine's state is out of date.
    fn forget(&mut self) {
        // No request that anybody else knows, so that whatever comes next loads its own.
        self.loaded = Arc::new(pb::SetHandlesRequest::default());
        self.shader = None;
    }

    /// Replaces the handles by new ones, for a commit. Until the commit is stored, `load` with the old ones goes back.
    pub fn replace(
        &mut self,
        trail: Option<&TopologyState>,
        handles: &pb::SetHandlesRequest,
        exec: &Exec<'_>,
    ) -> Result<(HandlePoses, pb::Session), wire::Error> {
        self.go(trail, exec)?;
        self.engine.set_handles(handles, exec)?;
        // No request that anybody else knows, so that whatever comes next loads its own.
        self.loaded = Arc::new(pb::SetHandlesRequest::default());
        Ok((self.engine.initial_poses(), self.engine.facts()))
    }

    /// Tells which request the handles of the last `replace` became.
    pub fn adopt(&mut self, handles: &Arc<pb::SetHandlesRequest>) {
        self.loaded = Arc::clone(handles);
    }

    /// Solves a pose with the handles in force.
    pub fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<SolvedShape, wire::Error> {
        exec.check()?;
        self.engine.solve(poses, settings, mode, exec, watch)
    }

    /// Makes a shape again.
    pub fn replay(&mut self, recipe: &Recipe, exec: &Exec<'_>) -> Result<Arc<Vec<DVec3>>, wire::Error> {
        match recipe {
            Recipe::Rest { trail } => {
                self.go(trail.as_ref(), exec)?;
                Ok(self.engine.rest())
            }
            Recipe::Solved {
                trail,
                handles,
                poses,
                settings,
            } => {
                self.load(trail.as_ref(), handles, exec)?;
                Ok(self
                    .solve(poses, settings, SolveMode::Commit, exec, &mut |_| true)?
                    .positions)
            }
        }
    }

    /// What makes normals and tangents; built when first asked for.
    pub fn shader(&mut self) -> Arc<Shader> {
        let Self { engine, shader, .. } = self;
        Arc::clone(shader.get_or_insert_with(|| Arc::new(engine.shader())))
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        self.engine.bytes() + self.shader.as_ref().map_or(0, |s| s.bytes())
    }
}
