//! Poses solved, and brought from the graph's nodes back to render vertices.

use super::Deformer;
use super::deformer::CommittedShape;
use super::error::{Error, InputPlace};
use super::pose::{HandlePose, HandlePoses};
use super::settings::{COMMIT_REFINE, SolveMode, SolveSettings};
use super::shape::{ModelShape, ShapeId};
use super::shape_transfer::ShapeTransfer;
use crate::deform::{
    CycleReport, HandleSystem, PoseRequest, PoseSolution, Refinement, SolutionExtent, SolveStart, Transform,
    unfold_faces,
};
use crate::exec::Exec;
use glam::DVec3;
use std::sync::{Arc, OnceLock};

/// A state of a solve that is under way, given to the watcher after every cycle.
pub struct SolveUpdate<'a> {
    /// Cycles done.
    pub cycle: u32,
    /// Fits of rotations done.
    pub refined: u32,
    /// Relative residual reached.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// Makes the render-vertex positions of this state; costs a pass over the vertices.
    pub positions: &'a dyn Fn() -> Vec<DVec3>,
}

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
                return Err(Error::invalid(InputPlace::PosedHandle(k), problem));
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
            strays: &handles.strays,
            riders: derived.riding_vertices(),
            pool: exec.pool,
        };
        let mut on_cycle = |cycle: &CycleReport<'_>| {
            let positions = || shape.render(&(cycle.positions)(), &[], &transforms);
            watch(&SolveUpdate {
                cycle: u32::try_from(cycle.index).unwrap_or(u32::MAX),
                refined: cycle.refined,
                residual: cycle.residual,
                max_error: cycle.max_error,
                positions: &positions,
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
