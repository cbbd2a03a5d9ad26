//! Poses solved, and brought from the graph's nodes back to render vertices.
//!
//! [`Deformer::solve`] takes all that a solve can be given. A [`Drag`], [`Deformer::commit`] and [`Deformer::edit_rest`] are
//! the short forms.

use crate::deform::{
    DeformableBody, FirstPass, HandleSystem, PoseRequest, Quality, SolutionExtent, SolveStart, SolveUpdate, Transform,
    fit_rigid_motion,
};
use crate::engine::Deformer;
use crate::engine::buckles::BuckleWatch;
use crate::engine::contact::{contact_bytes, part_drag};
use crate::engine::deformer::CommittedShape;
use crate::engine::derived_structures::{DerivedStructures, admit_bytes};
use crate::engine::edit_command::{Edit, EditCommand, EditOutcome, EditedShape};
use crate::engine::error::Error;
use crate::engine::handle::{HandlePose, HandlePoses};
use crate::engine::resolved_handles::check_free_rotation;
use crate::engine::riding::RidingVertices;
use crate::engine::riding_frames::RidingFrames;
use crate::engine::settings::{
    COMMIT_REFINE, Contact, DeformerLimits, HeldBeside, PoseChain, PoseRecipe, Recipe, SolveMode, SolveSettings,
};
use crate::engine::shape::{ModelShape, ShapeId};
use crate::exec::Exec;
use crate::mesh::carry::{CarrySurface, LocalGradients};
use crate::mesh::{Mesh, NONE};
use crate::pool::Pool;
use crate::reference::{Method, diffuse, linear_frames};
use glam::{DVec3, Mat3};
use rayon::prelude::*;
use std::sync::Arc;

impl Deformer {
    /// Returns `poses` with those that `changes` names replaced.
    ///
    /// # Errors
    /// [`Error::Precondition`] without handles, [`Error::Invalid`] for the id of a handle that is not set.
    pub fn change_poses<'a>(
        &self,
        poses: &HandlePoses,
        changes: impl IntoIterator<Item = (&'a str, HandlePose)>,
    ) -> Result<HandlePoses, Error> {
        self.require_handles()?;
        let mut all = poses.0.as_ref().clone();
        for (k, (id, pose)) in changes.into_iter().enumerate() {
            let handles = &self.handles().handles;
            let Some(at) = handles.iter().position(|h| h.id == id) else {
                let ids: Vec<_> = handles.iter().take(8).map(|h| format!("\"{}\"", h.id)).collect();
                let problem = format!("no handle \"{id}\" is set, there are {}", ids.join(", "));
                return Err(Error::invalid(format!("pose.handles[{k}].id"), problem));
            };
            let field = format!("pose.handles[{k}].pose");
            check_free_rotation(&handles[at], &pose, &field)?;
            all[at] = (self.handles).with_targets(at, pose, Some(&all[at]), self.rest(), &field)?;
        }
        Ok(HandlePoses(Arc::new(all)))
    }

    fn require_handles(&self) -> Result<&HandleSystem, Error> {
        self.handle_system
            .as_ref()
            .ok_or_else(|| Error::Precondition("no handles are set; set them before deforming".into()))
    }

    /// Refuses a method that the handles in force, or what is asked for beside it, do not go with, and what there is not enough memory for.
    fn check_request(&self, settings: &SolveSettings, mode: SolveMode, exec: &Exec<'_>) -> Result<(), Error> {
        if settings.method == Method::SpatialRbf && self.handles().handles.iter().any(|h| h.targets.is_some()) {
            let problem = "is SPATIAL_RBF, which cannot do with handles that have targets; GRAPH is allowed";
            return Err(Error::invalid("options.method", problem));
        }
        if settings.method == Method::SpatialRbf && settings.contact != Contact::Ignored {
            let problem = "is AVOID, which does not go with method SPATIAL_RBF; IGNORE is allowed";
            return Err(Error::invalid("options.contact", problem));
        }
        if settings.contact != Contact::Ignored && mode != SolveMode::Drag {
            let more = contact_bytes(self.derived.mesh.positions.len());
            admit_bytes(self.byte_size() + more, &self.room_limits(), exec)?;
        }
        Ok(())
    }

    /// The transforms of the system's handles for poses by handle, in model space. A free rotation is where the search for it
    /// begins; [`Deformer::transforms_in`] has those that were found.
    ///
    /// # Errors
    /// [`Error::Precondition`] without handles; [`Error::Internal`] when poses do not belong to the handles in force.
    pub fn transforms(&self, poses: &HandlePoses) -> Result<Vec<Transform>, Error> {
        self.require_handles()?;
        if poses.0.len() != self.handles().handles.len() {
            return Err(Error::Internal("poses of other handles".into()));
        }
        Ok(self.handles.transforms(&poses.0))
    }

    /// As [`Deformer::transforms`] of the `poses` of a shape (one position per render vertex), with the free rotations that it has.
    ///
    /// # Errors
    /// Those of [`Deformer::transforms`].
    pub fn transforms_in(&self, positions: &[DVec3], poses: &HandlePoses) -> Result<Vec<Transform>, Error> {
        let mut transforms = self.transforms(poses)?;
        let free = self.handles.turning_freely(&poses.0);
        if let Some(system) = self.handle_system.as_ref().filter(|_| !free.is_empty()) {
            let body = &self.derived.body;
            let now = |s: u32| positions[self.derived.mesh.render_vertices_of(s)[0] as usize];
            for hold in free {
                let nodes = &system.setup().handles[hold].nodes;
                let surface = nodes.iter().filter(|n| (**n as usize) < body.graph.surface);
                let (rest, there): (Vec<DVec3>, Vec<DVec3>) =
                    surface.map(|&n| (body.graph.positions[n as usize], now(n))).unzip();
                // Of one that holds next to nothing of the surface the rotation is the one that was given.
                if rest.len() > 2 {
                    transforms[hold].rotation = fit_rigid_motion(&rest, &there).rotation;
                }
            }
        }
        Ok(transforms)
    }

    /// What is held beside the memory of contact; not counted where there is none, for frames are many.
    fn held_beside(&self, contact: Contact) -> u64 {
        match contact {
            Contact::Ignored => 0,
            Contact::Avoided { .. } => self.byte_size(),
        }
    }

    /// Solves a pose. `watch` is called after every cycle; `false` takes the result as it is. Methods other than
    /// [`Method::Harmonic`] are for comparison.
    ///
    /// # Errors
    /// [`Error::Precondition`] without handles; [`Error::Cancelled`] when `progress` says so, within one cycle;
    /// [`Error::Internal`] when poses do not belong to the handles in force.
    pub fn solve(
        &mut self,
        poses: &HandlePoses,
        settings: &SolveSettings,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error> {
        let pose = PoseRecipe {
            poses: poses.clone(),
            settings: *settings,
        };
        self.solve_begun(&pose, mode, mode.start(), exec, watch)
    }

    /// As [`Deformer::solve`], but fits go on from the shape of other poses of the same handles. All of the chain are solved in turn, so the
    /// result depends on nothing that was solved before. `watch` sees the last one alone.
    ///
    /// # Errors
    /// Those of [`Deformer::solve`]; [`Error::Invalid`] for [`Method::SpatialRbf`], which goes on from no shape.
    pub fn solve_from(
        &mut self,
        chain: &PoseChain,
        mode: SolveMode,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error> {
        let PoseChain { starts, pose } = chain;
        if starts.is_empty() {
            return self.solve_begun(pose, mode, mode.start(), exec, watch);
        }
        if pose.settings.method == Method::SpatialRbf {
            let problem = "is SPATIAL_RBF, which goes on from no shape; GRAPH is allowed";
            return Err(Error::invalid("options.method", problem));
        }
        self.state.reset();
        let mut start = SolveStart::Fresh;
        for before in starts {
            self.solve_begun(before, SolveMode::Commit, start, exec, &mut |_| true)?;
            start = SolveStart::Shape;
        }
        self.solve_begun(pose, mode, start, exec, watch)
    }

    fn solve_begun(
        &mut self,
        pose: &PoseRecipe,
        mode: SolveMode,
        start: SolveStart,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<ModelShape, Error> {
        let PoseRecipe { poses, settings } = pose;
        let mut transforms = self.transforms(poses)?;
        self.check_request(settings, mode, exec)?;
        let free = self.handles.turning_freely(&poses.0);
        let limits = self.room_limits();
        let beside = HeldBeside::within(self.held_beside(settings.contact), limits.memory_bytes, exec.progress);
        let Self {
            handle_system: Some(handle_system),
            state,
            spatial_rbf,
            derived,
            handles,
            committed,
            solutions,
            ..
        } = self
        else {
            return Err(Error::Internal("handles without a system".into()));
        };
        let frames = frames_of(derived, settings.gradients && mode != SolveMode::Commit, &limits, exec)?;
        let body = &derived.body;
        let targets = handles.hold_targets(&poses.0, &handle_system.setup().handles, derived, exec);
        handle_system.set_targets(body, &targets, state, exec)?;
        let mut found = None;
        if !free.is_empty() {
            exec.progress.begin_pass("turn");
            let request = pose_request(&transforms, settings, mode, mode.start(), &[]);
            (transforms, found) = handle_system.find_turns(body, &request, &free, state, exec)?;
        }
        let request = pose_request(&transforms, settings, mode, start, derived.framed_nodes());
        let shape = ShapeTransfer {
            body,
            mesh: &derived.mesh,
            rest: &derived.topology().rest,
            unreferenced: &handles.unreferenced,
            riders: derived.riding_vertices(),
            frames,
            pool: exec.pool,
        };
        let mut on_cycle = |now: &SolveUpdate<'_>| {
            watch(&SolveUpdate {
                positions: &|| shape.render(&(now.positions)(), &[], &transforms).0,
                ..*now
            })
        };
        let mut with = |first_pass: FirstPass<'_>| {
            let request = PoseRequest { first_pass, ..request };
            handle_system.solve(body, &request, state, exec, &mut on_cycle)
        };
        let mut solved = match settings.method {
            Method::Harmonic => found.map_or_else(|| with(FirstPass::Harmonic), Ok)?,
            Method::Diffusion => with(FirstPass::Given(
                diffuse(body, handle_system, &transforms, exec)?.as_deref(),
            ))?,
            Method::LinearFrames => with(FirstPass::Given(
                linear_frames(body, handle_system, &transforms, exec.pool).as_deref(),
            ))?,
            Method::SpatialRbf => spatial_rbf.solve(handle_system, body, &transforms, state, exec)?,
        };
        exec.progress.begin_pass("settle");
        derived
            .thin
            .settle(body, handle_system, &solved.frames, &mut solved.positions, exec.pool);
        let buckles = || BuckleWatch::of(derived, handle_system, request, exec);
        let (contact, places) = (settings.contact, &mut solved.positions);
        match mode {
            SolveMode::Drag if contact == Contact::Ignored => state.contact().forget(),
            SolveMode::Drag => part_drag(derived, handle_system, state, &beside, places, exec.pool)?,
            SolveMode::Anew => buckles().part_surfaces(contact, state, places)?,
            SolveMode::Commit if settings.method == Method::SpatialRbf => {}
            SolveMode::Commit => solved = buckles().finished_commit(solved, settings, state)?,
        }
        exec.progress.begin_pass("render");
        let (positions, gradients) = shape.render(&solved.positions, &solved.frames, &transforms);
        *solutions += 1;
        let id = ShapeId::solution(derived.lineage.id, *solutions);
        match mode {
            SolveMode::Drag | SolveMode::Anew => state.recycle(solved.positions, solved.frames),
            SolveMode::Commit => {
                state.release_start();
                let nodes = Arc::new(solved.positions);
                *committed = Some(CommittedShape { id, nodes });
            }
        }
        Ok(ModelShape {
            id,
            positions: Arc::new(positions),
            stats: solved.stats,
            turns: handles.found_turns(&free, &transforms),
            gradients,
        })
    }
}

impl Deformer {
    /// Whether the last pose of a drag has left enough to do for [`Deformer::settle`].
    pub fn is_worth_settling(&self) -> bool {
        self.handle_system.is_some() && self.state.is_worth_settling()
    }

    /// Works ahead between two frames of a drag. A frame may leave as much undone as its tolerance allows; solved before the next
    /// one is asked for, that one goes out sooner. Does nothing where little is left ([`Deformer::is_worth_settling`]).
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::Internal`] where numbers left the range of single precision. A drag can go on after either.
    pub fn settle(&mut self, exec: &Exec<'_>) -> Result<(), Error> {
        match &self.handle_system {
            Some(handles) => Ok(handles.settle_drag(&self.derived.body, &mut self.state, exec)?),
            None => Ok(()),
        }
    }
}

/// The request of a pose in a mode. A drag's shape is made of positions and the frames of the nodes `framed`.
fn pose_request<'a>(
    transforms: &'a [Transform],
    settings: &SolveSettings,
    mode: SolveMode,
    start: SolveStart,
    framed: &'a [u32],
) -> PoseRequest<'a> {
    let (refine, extent) = match mode {
        SolveMode::Drag => (0, SolutionExtent::Surface(framed)),
        SolveMode::Anew | SolveMode::Commit => (COMMIT_REFINE, SolutionExtent::Graph),
    };
    PoseRequest {
        transforms,
        quality: Quality {
            refine: settings.quality.refine.or(Some(refine)),
            keeps_volume: settings.quality.keeps_volume && mode != SolveMode::Drag,
            ..settings.quality
        },
        start,
        first_pass: FirstPass::Harmonic,
        fits: settings.fits,
        extent,
        smooth_borders: settings.recipe >= Recipe::SmoothBorders
            && mode != SolveMode::Drag
            && settings.method == Method::Harmonic,
    }
}

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
    ) -> Result<ModelShape, Error> {
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
            settings: *settings,
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
    ) -> Result<ModelShape, Error> {
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

/// Binds what rides along, and packs it where frames have `gradients`.
fn frames_of<'d>(
    derived: &'d DerivedStructures,
    gradients: bool,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
) -> Result<Option<RidingFrames<'d>>, Error> {
    derived.bind_riders(limits, exec)?;
    gradients.then(|| derived.pack_riders(limits, exec)).transpose()
}

/// Vertices that one piece of work handles at least.
const PIECE: usize = 4096;

/// From graph nodes back to render vertices.
pub(super) struct ShapeTransfer<'a> {
    pub body: &'a DeformableBody,
    pub mesh: &'a Mesh,
    pub rest: &'a [DVec3],
    /// Render vertices in no face that a hard handle holds, with its hold.
    pub unreferenced: &'a [(u32, u32)],
    pub riders: Option<(&'a CarrySurface, &'a RidingVertices)>,
    /// The same packed, of frames with gradients.
    pub frames: Option<RidingFrames<'a>>,
    pub pool: &'a Pool,
}

impl ShapeTransfer<'_> {
    /// One position per render vertex for those of the nodes, their frames and the handles' transforms, and the gradients of the motion
    /// there, where they are wanted.
    pub fn render(
        &self,
        nodes: &[DVec3],
        frames: &[[f32; 9]],
        transforms: &[Transform],
    ) -> (Vec<DVec3>, Option<Arc<LocalGradients>>) {
        let at_rest = &self.body.graph.positions;
        let place = |(&rest, &solver): (&DVec3, &u32)| {
            let s = solver as usize;
            // Bits, not values: -0 and 0 are different bytes of the model.
            if solver == NONE || nodes[s] == at_rest[s] {
                return rest;
            }
            // Welding by tolerance leaves render vertices a little beside their solver vertex.
            let beside = rest - at_rest[s];
            let frame = frames.get(s).map_or(Mat3::IDENTITY, Mat3::from_cols_array);
            if beside == DVec3::ZERO {
                nodes[s]
            } else {
                nodes[s] + frame.as_dmat3() * beside
            }
        };
        let mut positions: Vec<DVec3> = self.pool.install(|| {
            let vertices = self.rest.par_iter().zip(&self.mesh.solver_from_render);
            vertices.with_min_len(PIECE).map(place).collect()
        });
        for &(vertex, hold) in self.unreferenced {
            if let Some(t) = transforms.get(hold as usize) {
                positions[vertex as usize] = t.map()(positions[vertex as usize]);
            }
        }
        // As elsewhere: what has not moved keeps the bits of the rest shape.
        let current = &nodes[..self.mesh.positions.len()];
        if let Some(frames) = &self.frames {
            let gradients = frames.place(current, Some(&mut positions), self.pool);
            return (positions, Some(gradients));
        }
        if let Some((surface, riders)) = self.riders {
            riders.place(surface, current, &mut positions, self.pool);
        }
        (positions, None)
    }
}
