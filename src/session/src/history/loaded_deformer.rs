//! An engine together with what it holds now, so that a piece of work that was given up half-way costs nothing but its
//! time: the next one brings the engine back to the handles that it needs.

use crate::capacity::work_watch::Work;
use crate::capacity::work_watch::report_solve;
use crate::engine::Engine;
use crate::history::session_state::{
    CommittedHandles, EditedState, HandleSetId, PosedState, SessionState, ShapeRecipe,
};
use crate::stream::frame_window::{FrameContext, ms_of};
use glam::DVec3;
use pliant_core::engine::{
    Deformer, ESTIMATED_MEMORY, EditCommand, Error, HandlePoses, HandleSet, ModelShape, PoseChain, PoseRecipe, Shader,
    Shading, SolveMode, SolveUpdate, TopologyState, digest,
};
use pliant_core::mesh::carry::LocalGradients;
use pliant_exec::Exec;
use pliant_wire::frames::{Frame, FrameOutput};
use pliant_wire::{
    DeformOptions, SessionEdit, add_found_turns, edit_result, found_turns_message, pb, quality_message,
    session_message, warning_message,
};
use std::sync::Arc;

/// The answer to a pose: its last frame, and what is to be committed where that was asked for.
pub(crate) struct PoseAnswer {
    pub frame: Frame,
    /// Cycles of the position solve.
    pub cycles: u32,
    pub commit: Option<PosedState>,
}

/// The engine of one session. Moves to the compute pool and back with every piece of work.
pub(crate) struct LoadedDeformer {
    /// The engine.
    pub engine: Box<dyn Engine>,
    /// The handles that the engine has; `None` when they have no id, so that the next work loads its own.
    loaded: Option<HandleSetId>,
    shader: Option<Arc<Shader>>,
    /// Bytes that the engine may hold after a change: what the other sessions leave.
    pub room: u64,
}

impl LoadedDeformer {
    /// A fresh engine, without handles; `loaded` names the session's empty set.
    pub fn new(engine: Box<dyn Engine>, loaded: HandleSetId) -> Self {
        Self {
            engine,
            loaded: Some(loaded),
            shader: None,
            room: u64::MAX,
        }
    }

    /// The deformer, for something that other engines do not do.
    pub fn deformer(&mut self, what: &str) -> Result<&mut Deformer, Error> {
        let unknown = || Error::Unimplemented(what.to_owned());
        self.engine.deformer().ok_or_else(unknown)
    }

    /// The state that edits have left the engine in; `None` when it knows no edits.
    pub fn topology_state(&mut self) -> Option<TopologyState> {
        self.engine.deformer().map(|deformer| deformer.topology_state())
    }

    /// Sets the bytes that the engine may hold after the next call.
    fn limit_memory(&mut self) {
        let room = self.room;
        if let Some(deformer) = self.engine.deformer() {
            deformer.limit_memory(room);
        }
    }

    /// What the engine says about model, solver and handles.
    fn facts(&self) -> Box<pb::Session> {
        Box::new(session_message(&self.engine.facts()))
    }

    /// Whether these handles are in force.
    pub fn has_loaded(&self, handles: HandleSetId) -> bool {
        self.loaded == Some(handles)
    }

    /// Makes `topology` the state that edits have left, and `handles` the ones in force.
    pub fn load_state(
        &mut self,
        topology: Option<&TopologyState>,
        handles: &CommittedHandles,
        exec: &Exec<'_>,
    ) -> Result<(), Error> {
        self.go_to_topology(topology, exec)?;
        if self.loaded != Some(handles.id) {
            self.set_handles(&handles.set, exec)?;
            self.loaded = Some(handles.id);
        }
        Ok(())
    }

    /// Sets handles. Where they fit, but not beside those in force, these are dropped first.
    fn set_handles(&mut self, handles: &HandleSet, exec: &Exec<'_>) -> Result<(), Error> {
        let spare = self.engine.deformer().map_or(0, |deformer| deformer.spare_bytes());
        match self.engine.set_handles(handles, exec) {
            Err(Error::TooLarge { what, seen, limit })
                if what == ESTIMATED_MEMORY && spare > 0 && seen.saturating_sub(spare) <= limit =>
            {
                self.release_memory();
                self.engine.set_handles(handles, exec)
            }
            done => done,
        }
    }

    /// Makes `topology` the state that edits have left.
    pub fn go_to_topology(&mut self, topology: Option<&TopologyState>, exec: &Exec<'_>) -> Result<(), Error> {
        let Some(topology) = topology else { return Ok(()) };
        let deformer = self.deformer("editing")?;
        if deformer.topology_state().is_same(topology) {
            return Ok(());
        }
        deformer.restore_topology(topology, exec)?;
        self.forget_derived();
        Ok(())
    }

    /// Edits the shape of a state, for a commit, with at most as many bytes held after it as there is room for. What does not fit is
    /// dropped. `shape` is the state's where it is at hand, and `recipe` how that is made again. Until the commit is stored,
    /// `load_state` with the old one goes back.
    pub fn edit_state(
        &mut self,
        state: &SessionState,
        shape: Option<ModelShape>,
        recipe: &ShapeRecipe,
        edit: &SessionEdit,
        exec: &Exec<'_>,
    ) -> Result<(EditedState, ModelShape, pb::EditResult), Error> {
        self.load_state(state.topology.as_ref(), &state.handles, exec)?;
        self.limit_memory();
        // What is known of a shape beside its vertices depends on its recipe alone, never on what the engine happens to remember.
        let shape = match shape {
            Some(shape) if self.engine.deformer().is_some_and(|d| d.remembers(shape.id)) => shape,
            _ => self.solve_recipe(recipe, exec)?,
        };
        let settings = match recipe {
            ShapeRecipe::Solved { chain, .. } => Some(&chain.pose.settings),
            ShapeRecipe::Rest { .. } => None,
        };
        let command = EditCommand {
            edit: &edit.edit,
            on: edit.on,
            shape: &shape,
            poses: &state.poses,
            settings,
        };
        self.load_state(state.topology.as_ref(), &state.handles, exec)?;
        let what = format!("the edit {}", edit.edit.kind().name());
        let outcome = self.deformer(&what)?.edit(&command, exec)?;
        self.forget_derived();
        if let Err(refused) = self.check_memory(exec) {
            self.go_to_topology(state.topology.as_ref(), exec)?;
            self.release_memory();
            return Err(refused);
        }
        let mut facts = self.facts();
        add_found_turns(&mut facts.handles, &found_turns_message(&outcome.shape.turns));
        let edited = EditedState {
            topology: self.topology_state(),
            diagonal: self.engine.diagonal(),
            handles: outcome.handles,
            poses: outcome.poses,
            facts,
            digest: outcome.report.digest.clone(),
            solved_with: outcome.solved,
        };
        Ok((edited, outcome.shape, edit_result(&outcome.report)))
    }

    /// Drops what is derived from the engine and made again when it is asked for.
    pub fn drop_derived(&mut self) {
        self.shader = None;
    }

    /// What was derived from the engine's state is out of date.
    fn forget_derived(&mut self) {
        self.loaded = None;
        self.shader = None;
    }

    /// Drops the handles and all that can be rebuilt: the next work loads its own.
    fn release_memory(&mut self) {
        self.engine.deformer().map(Deformer::release_memory);
        self.forget_derived();
    }

    /// Refuses what the engine holds now where that does not fit.
    fn check_memory(&self, exec: &Exec<'_>) -> Result<(), Error> {
        let seen = self.byte_size();
        if exec.progress.may_hold(seen) {
            return Ok(());
        }
        let what = ESTIMATED_MEMORY;
        Err(Error::TooLarge {
            what,
            seen,
            limit: self.room,
        })
    }

    /// Replaces the handles by new ones, for a commit, with at most as many bytes held as there is room for. Until the commit is stored, `load_state` with the old ones
    /// goes back. Where not both fit at a time, the old ones are dropped first, and made again when they are needed.
    pub fn replace_handles(
        &mut self,
        topology: Option<&TopologyState>,
        handles: &HandleSet,
        exec: &Exec<'_>,
    ) -> Result<(HandlePoses, Box<pb::Session>), Error> {
        self.go_to_topology(topology, exec)?;
        self.limit_memory();
        self.set_handles(handles, exec)?;
        self.loaded = None;
        if let Err(refused) = self.check_memory(exec) {
            self.release_memory();
            return Err(refused);
        }
        Ok((self.engine.initial_poses(), self.facts()))
    }

    /// Sets the id of the handles of the last [`LoadedDeformer::replace_handles`] or edit.
    pub fn adopt_handles(&mut self, handles: HandleSetId) {
        self.loaded = Some(handles);
    }

    /// Solves poses for a commit and measures them; the state's model and handles are in force. This is the one way to a
    /// committed shape, for calls and for streams; it depends on nothing but the state, the poses and the settings, and on what it goes
    /// on from.
    pub fn solve_for_commit(
        &mut self,
        seq: u64,
        chain: PoseChain,
        options: &DeformOptions,
        frames: &FrameContext,
        work: &Work<'_>,
    ) -> Result<PoseAnswer, Error> {
        let exec = &work.exec();
        let solved = self.solve(&chain, SolveMode::Commit, exec, &mut |_| true)?;
        let solve_time = work.watch.elapsed();
        let mut frame = self.last_frame(seq, options, frames, &solved);
        let mut warnings = Vec::new();
        frame.gradients = self.gradients(&solved.positions, options.output, exec)?;
        if let Some(deformer) = self.engine.deformer() {
            let quality = deformer.measure(&solved.positions, options.output.self_intersections, exec)?;
            frame.header.quality = Some(quality_message(&quality));
            let noticed = deformer.shape_warnings(&solved.positions, &chain.pose.poses, &chain.pose.settings, exec)?;
            warnings = noticed.iter().map(warning_message).collect();
        }
        frame.header.solve_ms = ms_of(solve_time);
        Ok(PoseAnswer {
            cycles: solved.stats.cycles,
            commit: Some(PosedState {
                warnings,
                found_turns: frame.header.found_turns.clone(),
                chain,
                digest: digest(&solved.positions),
                shape: Some(solved),
            }),
            frame,
        })
    }

    /// The frame that ends the work on the pose of number `seq`, without its time.
    pub fn last_frame(
        &mut self,
        seq: u64,
        options: &DeformOptions,
        frames: &FrameContext,
        solved: &ModelShape,
    ) -> Frame {
        let shading = self.shade(&solved.positions, options);
        let mut frame = frames.frame(seq, options.output, Arc::clone(&solved.positions), shading);
        frame.gradients = solved.gradients.clone();
        frame.header.r#final = true;
        frame.header.residual = solved.stats.residual;
        frame.header.max_error = solved.stats.max_error;
        frame.header.found_turns = found_turns_message(&solved.turns);
        frame
    }

    /// Makes the gradients of a shape, where `output` asks for them.
    ///
    /// # Errors
    /// Those of [`Deformer::gradients`](pliant_core::engine::Deformer::gradients).
    pub fn gradients(
        &mut self,
        positions: &[DVec3],
        output: FrameOutput,
        exec: &Exec<'_>,
    ) -> Result<Option<Arc<LocalGradients>>, Error> {
        match self.engine.deformer() {
            Some(deformer) if output.gradients => Ok(Some(deformer.gradients(positions, exec)?)),
            _ => Ok(None),
        }
    }

    /// Makes the normals and tangents that `settings` ask for; `None` when they ask for neither.
    pub fn shade(&mut self, positions: &[DVec3], settings: &DeformOptions) -> Option<Arc<Shading>> {
        let is_wanted = settings.output.normals || settings.output.tangents;
        is_wanted.then(|| Arc::new(self.shader().shade(positions)))
    }

    /// Solves a pose with the handles in force.
    pub fn solve(
        &mut self,
        chain: &PoseChain,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error> {
        exec.check()?;
        let PoseRecipe { poses, settings } = &chain.pose;
        let solved = match chain.starts[..] {
            [] => (self.engine).solve(poses, settings, mode, exec, watch)?,
            _ => (self.deformer("going on from a shape")?).solve_from(chain, mode, exec, watch)?,
        };
        report_solve(solved.stats.cycles, solved.stats.residual, solved.positions.len());
        Ok(solved)
    }

    /// Makes a shape again.
    pub fn solve_recipe(&mut self, recipe: &ShapeRecipe, exec: &Exec<'_>) -> Result<ModelShape, Error> {
        match recipe {
            ShapeRecipe::Rest { topology } => {
                self.go_to_topology(topology.as_ref(), exec)?;
                Ok(self.engine.rest_shape())
            }
            ShapeRecipe::Solved {
                topology,
                handles,
                chain,
            } => {
                self.load_state(topology.as_ref(), handles, exec)?;
                self.solve(chain, SolveMode::Commit, exec, &mut |_| true)
            }
        }
    }

    /// What makes normals and tangents; built when first asked for.
    pub fn shader(&mut self) -> Arc<Shader> {
        let Self { engine, shader, .. } = self;
        Arc::clone(shader.get_or_insert_with(|| Arc::new(engine.shader())))
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.engine.byte_size() + self.shader.as_ref().map_or(0, |s| s.byte_size())
    }
}
