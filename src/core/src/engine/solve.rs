//! Poses solved, and brought from the graph's nodes back to render vertices.
//!
//! [`Deformer::solve`] takes all that a solve can be given. A [`Drag`], [`Deformer::commit`] and [`Deformer::edit_rest`] are
//! the short forms.

use crate::deform::{
    DeformableBody, HandleSystem, PoseRequest, PoseSolution, Refinement, SolutionExtent, SolveStart, SolveUpdate,
    Transform, unfold_faces,
};
use crate::engine::Deformer;
use crate::engine::deformer::CommittedShape;
use crate::engine::edit_command::{Edit, EditCommand, EditOutcome, EditedShape};
use crate::engine::error::Error;
use crate::engine::handle::{HandlePose, HandlePoses};
use crate::engine::riding::RidingVertices;
use crate::engine::settings::{COMMIT_REFINE, SolveMode, SolveSettings};
use crate::engine::shape::{ModelShape, ShapeId};
use crate::exec::Exec;
use crate::mesh::carry::CarrySurface;
use crate::mesh::{Mesh, NONE};
use crate::pool::Pool;
use glam::{DVec3, Mat3};
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// A solved pose.
#[derive(Debug, Clone)]
pub struct SolvedShape {
    /// The name of the shape.
    pub id: ShapeId,
    /// One per render vertex, model space. Where nothing moves, the bits of the rest pose.
    pub positions: Arc<Vec<DVec3>>,
    /// Cycles of the position solve.
    pub cycles: u32,
    /// Relative residual reached, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// Name of the method that the solver ended with.
    pub solver: &'static str,
}

impl SolvedShape {
    /// Returns the shape alone, to go on from.
    pub fn shape(&self) -> ModelShape {
        ModelShape {
            id: self.id,
            positions: Arc::clone(&self.positions),
        }
    }
}

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
            all[at] = pose;
        }
        Ok(HandlePoses(Arc::new(all)))
    }

    fn require_handles(&self) -> Result<&HandleSystem, Error> {
        self.rig
            .as_ref()
            .ok_or_else(|| Error::Precondition("no handles are set; set them before deforming".into()))
    }

    /// The transforms of the rig's holds for poses by handle, in model space.
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

    /// Solves a pose. `watch` is called after every cycle; `false` takes the result as it is.
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
    ) -> Result<SolvedShape, Error> {
        let transforms = self.transforms(poses)?;
        self.derived.bind_riders(&self.room_limits(), exec)?;
        let Self {
            rig: Some(rig),
            state,
            spatial_rbf,
            derived,
            handles,
            committed,
            solutions,
            ..
        } = self
        else {
            return Err(Error::Internal("handles without a rig".into()));
        };
        let body = &derived.body;
        let request = PoseRequest {
            transforms: &transforms,
            tolerance: settings.tolerance,
            max_error: settings.max_error,
            start: if mode == SolveMode::Drag {
                SolveStart::Warm
            } else {
                SolveStart::Fresh
            },
            first_pass: settings.first_pass,
            refinement: Refinement {
                steps: settings.refine.unwrap_or(match mode {
                    SolveMode::Drag => 0,
                    SolveMode::Commit => COMMIT_REFINE,
                }),
                smoothing: settings.rotation_smoothing,
                carried: false,
                order: settings.fit_order,
            },
            extent: extent_of(mode, derived.shows_without_frames()),
        };
        let shape = ShapeTransfer {
            body,
            mesh: &derived.mesh,
            rest: &derived.topology().rest,
            unreferenced: &handles.unreferenced,
            riders: derived.riding_vertices(),
            pool: exec.pool,
        };
        let mut on_cycle = |now: &SolveUpdate<'_>| {
            watch(&SolveUpdate {
                positions: &|| shape.render(&(now.positions)(), &[], &transforms),
                ..*now
            })
        };
        let mut solution = match settings.spatial_rbf {
            true => spatial_rbf.solve(rig, body, &transforms, state, exec)?,
            false => rig.solve(body, &request, state, exec, &mut on_cycle)?,
        };
        exec.progress.begin_pass("settle");
        derived
            .thin
            .settle(body, rig, &solution.frames, &mut solution.positions, exec.pool);
        if mode == SolveMode::Commit && !settings.spatial_rbf {
            exec.progress.begin_pass("unfold");
            let surroundings = OnceLock::new();
            unfold_faces(&derived.mesh, &surroundings, rig, &mut solution.positions, exec.pool);
        }
        let solver = method_name(&solution);
        exec.progress.begin_pass("render");
        let positions = Arc::new(shape.render(&solution.positions, &solution.frames, &transforms));
        *solutions += 1;
        let id = ShapeId::solution(derived.lineage.id, *solutions);
        match mode {
            SolveMode::Drag => state.recycle(solution.positions, solution.frames),
            SolveMode::Commit => {
                state.release_start();
                *committed = Some(CommittedShape {
                    id,
                    nodes: Arc::new(solution.positions),
                });
            }
        }
        Ok(SolvedShape {
            id,
            positions,
            cycles: u32::try_from(solution.iterations).unwrap_or(u32::MAX),
            residual: solution.residual,
            max_error: solution.max_error,
            solver,
        })
    }
}

impl Deformer {
    /// Whether the last pose of a drag has left enough to do for [`Deformer::settle`].
    pub fn is_worth_settling(&self) -> bool {
        self.rig.is_some() && self.state.is_worth_settling()
    }

    /// Works ahead between two frames of a drag. A frame may leave as much undone as its tolerance allows; solved before the next
    /// one is asked for, that one goes out sooner. Does nothing where little is left ([`Deformer::is_worth_settling`]).
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::Internal`] where numbers left the range of single precision. A drag can go on after either.
    pub fn settle(&mut self, exec: &Exec<'_>) -> Result<(), Error> {
        match &self.rig {
            Some(rig) => Ok(rig.settle_drag(&self.derived.body, &mut self.state, exec)?),
            None => Ok(()),
        }
    }
}

/// How much of a solution is needed. Where the surface shows without frames a drag has no use for them.
fn extent_of(mode: SolveMode, shows_without_frames: bool) -> SolutionExtent {
    match mode {
        SolveMode::Drag if shows_without_frames => SolutionExtent::Positions,
        SolveMode::Drag => SolutionExtent::Surface,
        SolveMode::Commit => SolutionExtent::Graph,
    }
}

fn method_name(solution: &PoseSolution) -> &'static str {
    use crate::deform::PoseMethod::{Graph, SpatialRbf};
    use crate::solver::SolveMethod as Solver;
    match solution.method {
        Graph(Solver::Trivial) => "trivial",
        Graph(Solver::Direct) => "direct",
        Graph(Solver::Multigrid) => "multigrid",
        Graph(Solver::PaperCycles) => "paper-cycles",
        Graph(Solver::ConjugateGradients) => "conjugate-gradients",
        SpatialRbf => "spatial-rbf",
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
    pub pool: &'a Pool,
}

impl ShapeTransfer<'_> {
    /// One position per render vertex for those of the nodes, their frames and the handles' transforms.
    pub fn render(&self, nodes: &[DVec3], frames: &[[f32; 9]], transforms: &[Transform]) -> Vec<DVec3> {
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
        if let Some((surface, riders)) = self.riders {
            // As elsewhere: what has not moved keeps the bits of the rest shape.
            let current = &nodes[..self.mesh.positions.len()];
            riders.place(surface, current, &mut positions, self.pool);
        }
        positions
    }
}
