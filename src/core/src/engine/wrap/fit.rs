//! The fit itself: targets that follow the closest points, pulled harder from level to level.

use super::facing::{FacingLimits, FacingPlace, FacingTree, OrientedPoint};
use super::normals::smooth_normals;
use super::queries::answers;
use super::target::TargetSurface;
use super::task::WrapTask;
use super::two_way::pulls_from_target;
use crate::deform::{
    BodyOptions, DeformableBody, HandleConstraint, HandleSetup, HandleSystem, HoldTargets, PoseRequest, Quality,
    SolveState, Transform, VolumeMode, unfold_faces,
};
use crate::engine::error::Error;
use crate::engine::target_vertices::{SHARES, shares_of_area};
use crate::exec::Exec;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use std::sync::OnceLock;

/// What a share of 1/10000 of the template's area is pulled with, level by level.
pub(super) const LEVELS: [f64; 5] = [0.02, 0.1, 0.4, 1.5, 6.0];
/// Steps of a level: each finds closest points again.
pub(super) const STEPS: usize = 4;
/// What a landmark is pulled with before the first level and at it, and at the last one.
const LANDMARKS: [f64; 2] = [20.0, 8.0];
/// A closest point counts within this share of the diagonal, at the first step and at the last.
const FARTHEST: [f64; 2] = [0.15, 0.01];
/// What normals that are a radian apart count as when closest points are looked for, in parts of how far one may be: at the first
/// step, where limbs are of other thickness, and at the last, where the surfaces lie on each other.
const TURNS: [f64; 2] = [1.5, 0.1];
/// The first level at which the template is a surface alone. Before, its inside keeps legs and necks from being folded flat.
const SURFACE_FROM: usize = 1;
/// What a mean of pulls from the target weighs beside the vertex's own.
const FROM_TARGET: f64 = 0.8;
/// Closest points are looked for from so many times the last step ahead of each vertex. Surfaces slide along each other slowly,
/// for a closest point lets a vertex go no further; with this, few steps slide as far as many without.
const AHEAD: f64 = 0.8;
/// Fits of rotations in a step.
const FITS: u32 = 4;
/// The first level at which the target pulls too.
const TWO_WAY_FROM: usize = 1;

/// The holds.
const ALL: usize = 0;
const ANCHORED: usize = 1;

/// Where a vertex is wanted, and how surely.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Wanted {
    pub place: DVec3,
    pub weight: f64,
}

/// Watches what is built and solved in a step, which reports no stages of its own: they are parts of the wrap.
struct WithinStep<'a>(&'a dyn Progress);

impl Progress for WithinStep<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }

    fn may_hold(&self, bytes: u64) -> bool {
        self.0.may_hold(bytes)
    }
}

/// A template under way to a target.
pub(super) struct WrapFit<'a> {
    task: &'a WrapTask<'a>,
    target: &'a TargetSurface,
    facing: FacingTree<'a>,
    /// By vertex, whether the target pulls it.
    pulled: &'a [bool],
    /// The triangles of which a corner is pulled.
    triangles: Vec<[u32; 3]>,
    /// By vertex, its share of the area.
    shares: Vec<f64>,
    diagonal: f64,
    solver: FitSolver,
    pub now: Vec<DVec3>,
    /// Where vertices are looked for: ahead of where they are, the way they go.
    ahead: Vec<DVec3>,
    /// By vertex, the triangle of the target that the step before found; and the other way round.
    near: Vec<Option<u32>>,
    near_target: Vec<Option<u32>>,
}

impl<'a> WrapFit<'a> {
    /// Prepares a template where it is.
    ///
    /// # Errors
    /// Those of building a body; [`Error::Cancelled`].
    pub fn new(
        task: &'a WrapTask<'a>,
        target: &'a TargetSurface,
        pulled: &'a [bool],
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let mesh = task.template;
        let mut triangles = mesh.triangles.clone();
        triangles.retain(|t| t.iter().any(|v| pulled[*v as usize]));
        Ok(Self {
            task,
            target,
            facing: FacingTree::new(target.tree(exec), &target.normals),
            pulled,
            triangles,
            shares: shares_of_area(mesh),
            diagonal: mesh.bounds().diagonal(),
            solver: FitSolver::new(
                mesh.clone(),
                task,
                true,
                &Exec::new(exec.pool, &WithinStep(exec.progress)),
            )?,
            now: mesh.positions.clone(),
            ahead: mesh.positions.clone(),
            near: vec![None; mesh.positions.len()],
            near_target: vec![None; target.mesh.positions.len()],
        })
    }

    /// Goes through all levels.
    ///
    /// # Errors
    /// [`Error::Cancelled`], and those of solving.
    pub fn run(&mut self, exec: &Exec<'_>) -> Result<(), Error> {
        let (progress, quiet) = (exec.progress, WithinStep(exec.progress));
        let exec = &Exec::new(exec.pool, &quiet);
        progress.report("wrap", 0.0);
        if !self.task.landmarks.is_empty() {
            let none = vec![Wanted::default(); self.now.len()];
            self.solve(&none, LANDMARKS[0], exec)?;
            self.ahead.clone_from(&self.now);
        }
        let steps = LEVELS.len() * STEPS;
        for step in 0..steps {
            exec.check()?;
            let along = step as f64 / (steps - 1) as f64;
            progress.report("wrap", along as f32);
            let level = step / STEPS;
            if level > 0 && step % STEPS == 0 {
                let mut mesh = self.task.template.clone();
                mesh.positions.clone_from(&self.now);
                self.solver = FitSolver::new(mesh, self.task, level < SURFACE_FROM, exec)?;
            }
            let within = self.diagonal * between(FARTHEST, along);
            let reach = FacingLimits {
                within,
                turn: within * between(TURNS, along),
            };
            let mut wanted = self.closest_points(reach, exec)?;
            if level >= TWO_WAY_FROM {
                self.add_pulls_from_target(&mut wanted, reach, exec)?;
            }
            for (vertex, wanted) in wanted.iter_mut().enumerate() {
                wanted.weight *= LEVELS[level] * self.shares[vertex];
            }
            if self.task.landmarks.is_empty() && !wanted.iter().any(|w| w.weight > 0.0) {
                let problem = "nothing of the target is near the model and faces the same way; give landmarks that say how the target is \
                               placed";
                return Err(Error::Precondition(problem.into()));
            }
            self.solve(&wanted, between(LANDMARKS, along), exec)?;
        }
        unfold_faces(
            self.task.template,
            &OnceLock::new(),
            &self.solver.handles,
            &mut self.now,
            exec.pool,
        );
        Ok(())
    }

    /// Where the target is closest to each vertex and faces the same way.
    fn closest_points(&mut self, reach: FacingLimits, exec: &Exec<'_>) -> Result<Vec<Wanted>, Error> {
        let normals = smooth_normals(&self.now, &self.task.template.triangles);
        let facing = &self.facing;
        let find = |vertex: usize| {
            let (point, normal) = (self.ahead[vertex], normals[vertex]);
            if !self.pulled[vertex] || self.target.ends_at(&facing.tree, point, reach.within) {
                return None;
            }
            facing.closest(OrientedPoint { point, normal }, reach, self.near[vertex])
        };
        let found = answers(&facing.tree, self.now.len(), exec, find)?;
        self.near = found.iter().map(|f| f.map(|f| f.triangle)).collect();
        let inner = |found: &FacingPlace| !self.target.has_border_at(found.triangle, found.point);
        let wanted = found.into_iter().map(|found| match found.filter(inner) {
            Some(found) => Wanted {
                place: found.point,
                weight: found.cosine,
            },
            None => Wanted::default(),
        });
        Ok(wanted.collect())
    }

    fn add_pulls_from_target(
        &mut self,
        wanted: &mut [Wanted],
        reach: FacingLimits,
        exec: &Exec<'_>,
    ) -> Result<(), Error> {
        let near = &mut self.near_target;
        let pulls = pulls_from_target(self.target, &self.now, &self.triangles, reach, near, exec)?;
        for (vertex, pull) in pulls.into_iter().filter(|(v, _)| self.pulled[*v as usize]) {
            let own = &mut wanted[vertex as usize];
            let weight = own.weight + FROM_TARGET;
            own.place = (own.place * own.weight + pull * FROM_TARGET) / weight;
            own.weight = weight.min(1.0);
        }
        Ok(())
    }

    fn solve(&mut self, wanted: &[Wanted], landmarks: f64, exec: &Exec<'_>) -> Result<(), Error> {
        let anchors = self.anchors(landmarks);
        let before = std::mem::replace(&mut self.now, self.solver.solve(wanted, &anchors, exec)?);
        for (ahead, (now, before)) in self.ahead.iter_mut().zip(self.now.iter().zip(&before)) {
            *ahead = *now + (*now - *before) * AHEAD;
        }
        Ok(())
    }

    /// Where the corners that landmarks are between are wanted: moved as their landmark has to.
    fn anchors(&self, stiffness: f64) -> Vec<Wanted> {
        // Of a coarse template each vertex stands for much area, and closest points pull it more than one landmark should be pulled.
        let stiffness = stiffness * f64::max(1.0, SHARES / self.now.len() as f64);
        let nodes = &self.solver.anchored;
        let mut sums = vec![Wanted::default(); nodes.len()];
        for landmark in self.task.landmarks {
            let at = landmark.place(&self.now);
            for &(vertex, share) in landmark.own.iter().filter(|c| c.1 > 0.0) {
                let Ok(k) = nodes.binary_search(&vertex) else {
                    continue;
                };
                let weight = share * stiffness;
                sums[k].place += (self.now[vertex as usize] + landmark.target - at) * weight;
                sums[k].weight += weight;
            }
        }
        for sum in &mut sums {
            sum.place /= f64::max(sum.weight, f64::MIN_POSITIVE);
        }
        sums
    }
}

/// From one number to another, in equal ratios.
fn between([from, to]: [f64; 2], along: f64) -> f64 {
    from * libm::pow(to / from, along)
}

/// The body in the shape whose edges are kept, with a pull on every vertex and on the corners of landmarks.
struct FitSolver {
    body: DeformableBody,
    handles: HandleSystem,
    state: SolveState,
    anchored: Vec<u32>,
}

impl FitSolver {
    fn new(rest: Mesh, task: &WrapTask<'_>, with_inside: bool, exec: &Exec<'_>) -> Result<Self, Error> {
        let options = BodyOptions {
            volume: if with_inside { VolumeMode::Auto } else { VolumeMode::Off },
            ..task.body.clone()
        };
        let body = DeformableBody::build(&rest, &options, exec)?;
        let corners = task.landmarks.iter().flat_map(|l| l.own).filter(|c| c.1 > 0.0);
        let anchored = crate::mesh::sorted_set(corners.map(|c| c.0));
        let pulling = |nodes: Vec<u32>| HandleConstraint {
            pulls: nodes.iter().map(|n| (*n, 1.0)).collect(),
            nodes,
            stiffness: Some(1.0),
            position: true,
            ..HandleConstraint::default()
        };
        let setup = HandleSetup {
            handles: vec![
                pulling((0..rest.positions.len() as u32).collect()),
                pulling(anchored.clone()),
            ],
            ..HandleSetup::default()
        };
        let handles = HandleSystem::build(&body, setup, exec)?;
        Ok(Self {
            body,
            handles,
            state: SolveState::default(),
            anchored,
        })
    }

    fn solve(&mut self, wanted: &[Wanted], anchors: &[Wanted], exec: &Exec<'_>) -> Result<Vec<DVec3>, Error> {
        let targets = |hold: usize, all: &[Wanted]| HoldTargets {
            hold,
            places: all.iter().map(|w| w.place).collect(),
            weights: all.iter().map(|w| w.weight).collect(),
            points: Vec::new(),
        };
        let targets = [targets(ALL, wanted), targets(ANCHORED, anchors)];
        self.handles.set_targets(&self.body, &targets, &mut self.state, exec)?;
        let transforms = [Transform::IDENTITY; 2];
        let quality = Quality {
            refine: Some(FITS),
            keeps_volume: false,
            ..Quality::DEFAULT
        };
        let request = PoseRequest::new(&transforms, quality);
        let solved = (self.handles).solve(&self.body, &request, &mut self.state, exec, &mut |_| true)?;
        self.state.release_start();
        let mut positions = solved.positions;
        positions.truncate(wanted.len());
        Ok(positions)
    }
}
