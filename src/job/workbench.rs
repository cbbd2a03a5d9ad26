//! One model on the bench: everything derived from it, its handles, and poses solved on request.

use super::check::{COMMIT_REFINE, Settings, transform};
use super::create::Choices;
use super::foundation::{Foundation, primitive};
use super::handles::{HandleSet, resolve_handles};
use super::interior::{self, BYTES_PER_NODE};
use super::quality::quality;
use super::region::Ground;
use super::{Error, pb};
use crate::asset::{self, FileSet, Format, Geometry, Model, Written};
use crate::deform::{Body, Cycle, Refinement, Request, Rig, Solution, Start, State, Transform, VolumeMode};
use crate::graph::estimate_nodes;
use crate::mesh::{Adjacency, Components, Mesh, NONE, Report, inspect, self_intersections};
use crate::pool::Pool;
use crate::progress::{Progress, check};
use glam::{DVec3, Mat3};
use std::sync::Arc;

/// Bytes that a render vertex with its triangles costs beside the graph.
const BYTES_PER_VERTEX: u64 = 500;

/// What a bench may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Sizes of the model.
    pub model: asset::Limits,
    /// Bytes that the bench may hold; checked by estimate before anything large is allocated.
    pub memory_bytes: u64,
    /// Handles of one request.
    pub handles: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            model: asset::Limits::default(),
            memory_bytes: 16 << 30,
            handles: 1024,
        }
    }
}

/// The pose of every handle in force, in the order of the handles. Cheap to clone.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Poses(pub Arc<Vec<pb::HandlePose>>);

/// How a solve treats what was solved before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Starts from the last result, for the sake of speed.
    Drag,
    /// Depends on nothing but model, handles, poses and settings, so that it can be repeated to the bit.
    Commit,
}

/// A state of a solve that is under way, given to the watcher after every cycle.
pub struct Watch<'a> {
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
pub struct Solved {
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

/// A model with everything derived from it. One owner; solves need `&mut`.
pub struct Workbench {
    pub(super) foundation: Arc<Foundation>,
    pub(super) mesh: Mesh,
    parts: Components,
    report: Report,
    body: Body,
    pub(super) choices: Choices,
    pub(super) limits: Limits,
    warnings: Vec<pb::Warning>,
    handles: HandleSet,
    rig: Option<Rig>,
    state: State,
}

impl Workbench {
    /// Reads a model and builds mesh, graph and hierarchy. Reports the stages "read", "mesh", "graph", "hierarchy" to
    /// `progress` as they start.
    ///
    /// # Errors
    /// [`Error::Asset`], [`Error::Invalid`] for options, [`Error::TooLarge`] when the estimate of what the bench would
    /// hold is above `limits`, [`Error::Cancelled`].
    pub fn open(
        files: FileSet,
        create: &pb::CreateOptions,
        limits: &Limits,
        pool: &Pool,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let choices = Choices::check(create)?;
        progress.report("read", 0.0);
        let model = Model::read(files, choices.format, &limits.model)?;
        check(progress)?;
        progress.report("mesh", 0.0);
        Self::on(Arc::new(Foundation::new(model)), choices, limits, pool, progress)
    }

    /// Builds mesh, graph and hierarchy on a model, edited or not.
    pub(super) fn on(
        foundation: Arc<Foundation>,
        choices: Choices,
        limits: &Limits,
        pool: &Pool,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        progress.report("mesh", 0.0);
        let vertices = foundation.rest.len() as u64;
        let files = foundation.model.files.total_bytes();
        admit(vertices * BYTES_PER_VERTEX + files, limits)?;
        let mesh = foundation.mesh(choices.weld)?;
        let adjacency = Adjacency::build(mesh.positions.len(), &mesh.triangles);
        let report = inspect(&mesh, &adjacency);
        let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
        drop(adjacency);
        check(progress)?;

        // Without a wish for interior nodes they are what may be left out to stay within the limits.
        let nodes = if choices.body.volume == VolumeMode::Required {
            estimate_nodes(&mesh)
        } else {
            mesh.positions.len()
        };
        admit(estimate(vertices, nodes as u64) + files, limits)?;
        let beside = vertices * BYTES_PER_VERTEX + files;
        let mut options = choices.body.clone();
        options.apart = foundation.is_apart();
        interior::fit(&mut options, beside, limits);
        let body = Body::build(&mesh, &options, pool, progress)?;
        let mut warnings = warnings_of(&foundation.model, &report);
        warnings.extend(interior::warnings(&body, choices.body.volume));
        Ok(Self {
            foundation,
            mesh,
            parts,
            report,
            body,
            choices,
            limits: *limits,
            warnings,
            handles: HandleSet::default(),
            rig: None,
            state: State::default(),
        })
    }

    /// The model as it was read.
    pub fn model(&self) -> &Model {
        &self.foundation.model
    }

    /// Triangles, normals, tangents and primitives as they are now. Once edited, positions are those of [`Workbench::rest`]
    /// alone.
    pub fn geometry(&self) -> &Geometry {
        self.foundation.geometry()
    }

    /// The model at `positions` (one per render vertex) as files.
    ///
    /// # Errors
    /// Those of [`Model::write`].
    pub fn write(&self, positions: &[DVec3], format: Format) -> Result<Written, Error> {
        self.foundation.write(positions, format)
    }

    /// What was found about the mesh.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// The graph and hierarchy.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// The handles on the body, once set.
    pub fn rig(&self) -> Option<&Rig> {
        self.rig.as_ref()
    }

    /// Positions at rest, one per render vertex.
    pub fn rest(&self) -> &Arc<Vec<DVec3>> {
        &self.foundation.rest
    }

    /// Length of the bounding box's diagonal.
    pub fn diagonal(&self) -> f64 {
        self.body.diagonal
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        let model = self.foundation.model.files.total_bytes() + self.foundation.bytes();
        let parts = self.mesh.bytes()
            + self.parts.of_vertex.capacity() * 4
            + self.body.bytes()
            + self.rig.as_ref().map_or(0, Rig::bytes)
            + self.state.bytes();
        model + parts as u64
    }

    /// Bytes that a bench for this model is expected to hold at most.
    pub fn estimate(&self) -> u64 {
        estimate(self.rest().len() as u64, self.body.nodes() as u64) + self.model().files.total_bytes()
    }

    /// What a session answers about model, solver and handles; id, revision, times and limits are the caller's.
    pub fn facts(&self) -> pb::Session {
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let levels = self
            .body
            .hierarchy
            .levels()
            .iter()
            .map(|l| pb::solver_facts::Level {
                vertices: count(l.vertices),
                edges: l.edges as u64,
            })
            .collect();
        pb::Session {
            primitives: self.geometry().primitives.iter().map(primitive).collect(),
            warnings: self.warnings.iter().chain(&self.handles.warnings).cloned().collect(),
            model: Some(pb::ModelFacts {
                format: self.model().format.name().into(),
                bytes: self.model().files.total_bytes(),
                sha256: self.foundation.sha256.to_string(),
                vertices: count(self.rest().len()),
                triangles: count(self.geometry().triangles.len()),
            }),
            solver: Some(pb::SolverFacts {
                solver_vertices: count(self.mesh.positions.len()),
                graph_vertices: count(self.body.nodes()),
                graph_edges: self.body.graph.neighbours.len() as u64 / 2,
                components: count(self.parts.count),
                levels,
                bytes: self.bytes(),
            }),
            handles: self.handle_facts(),
            ..Default::default()
        }
    }

    fn handle_facts(&self) -> Vec<pb::HandleFacts> {
        let handles = self.handles.request.handles.iter();
        handles
            .zip(self.handles.counts.iter().zip(&self.handles.centroids))
            .map(|(h, (&vertices, c))| pb::HandleFacts {
                id: h.id.clone(),
                vertices,
                centroid: c.to_array().to_vec(),
            })
            .collect()
    }

    /// The handles in force.
    pub fn handles(&self) -> &pb::SetHandlesRequest {
        &self.handles.request
    }

    /// Replaces the handles and recomputes the first-pass fields (stage "fields"). On an error the old ones stay. An
    /// empty list takes all handles away.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the field, [`Error::Precondition`] when the handles leave the model without a place,
    /// [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn set_handles(
        &mut self,
        request: &pb::SetHandlesRequest,
        pool: &Pool,
        progress: &dyn Progress,
    ) -> Result<(), Error> {
        let ground = self.ground();
        let (set, rigging) = resolve_handles(&ground, &self.body, request, self.choices.policy, self.limits.handles)?;
        let field_bytes = (rigging.holds.len() as u64 + 1) * self.body.nodes() as u64 * 12;
        admit(self.estimate() + field_bytes, &self.limits)?;
        let rig = match request.handles.is_empty() {
            true => None,
            false => Some(Rig::build(&self.body, rigging, pool, progress)?),
        };
        self.handles = set;
        self.rig = rig;
        self.state = State::default();
        Ok(())
    }

    /// What regions are resolved against.
    pub(super) fn ground(&self) -> Ground<'_> {
        Ground {
            positions: &self.foundation.rest,
            primitives: &self.geometry().primitives,
            mesh: &self.mesh,
            parts: &self.parts,
            graph: &self.body.graph,
        }
    }

    /// Default pivots of the handles in force.
    pub(super) fn centroids(&self) -> &[DVec3] {
        &self.handles.centroids
    }

    /// The poses that the handles in force came with.
    pub fn initial_poses(&self) -> Poses {
        Poses(Arc::new(
            self.handles
                .request
                .handles
                .iter()
                .map(|h| h.pose.clone().unwrap_or_default())
                .collect(),
        ))
    }

    /// `poses` with those that `change` names replaced. Checks every number.
    ///
    /// # Errors
    /// [`Error::Precondition`] without handles, [`Error::Invalid`] with the field.
    pub fn posed(&self, poses: &Poses, change: &pb::Pose) -> Result<Poses, Error> {
        self.require_handles()?;
        let mut all = poses.0.as_ref().clone();
        for (k, entry) in change.handles.iter().enumerate() {
            let handles = &self.handles.request.handles;
            let Some(at) = handles.iter().position(|h| h.id == entry.id) else {
                let ids: Vec<_> = handles.iter().take(8).map(|h| format!("\"{}\"", h.id)).collect();
                let problem = format!("no handle \"{}\" is set, there are {}", entry.id, ids.join(", "));
                return Err(Error::invalid(format!("pose.handles[{k}].id"), problem));
            };
            let pose = entry.pose.clone().unwrap_or_default();
            transform(&pose, self.handles.centroids[at], &format!("pose.handles[{k}].pose"))?;
            all[at] = pose;
        }
        Ok(Poses(Arc::new(all)))
    }

    fn require_handles(&self) -> Result<&Rig, Error> {
        self.rig
            .as_ref()
            .ok_or_else(|| Error::Precondition("no handles are set; set them before deforming".into()))
    }

    /// The transforms of the rig's holds for poses by handle, in model space.
    ///
    /// # Errors
    /// [`Error::Precondition`] without handles; [`Error::Invalid`] when poses do not belong to the handles in force.
    pub fn transforms(&self, poses: &Poses) -> Result<Vec<Transform>, Error> {
        self.require_handles()?;
        if poses.0.len() != self.handles.request.handles.len() {
            return Err(Error::Internal("poses of other handles".into()));
        }
        self.handles.transforms(&poses.0)
    }

    /// Solves a pose. `watch` is called after every cycle; `false` takes the result as it is.
    ///
    /// # Errors
    /// [`Error::Precondition`] without handles; [`Error::Cancelled`] when `progress` says so, within one cycle;
    /// [`Error::Invalid`] when poses do not belong to the handles in force.
    pub fn solve(
        &mut self,
        poses: &Poses,
        settings: &Settings,
        mode: Mode,
        pool: &Pool,
        progress: &dyn Progress,
        watch: &mut dyn FnMut(&Watch<'_>) -> bool,
    ) -> Result<Solved, Error> {
        let transforms = self.transforms(poses)?;
        let Self {
            rig: Some(rig),
            state,
            body,
            mesh,
            handles,
            foundation,
            ..
        } = self
        else {
            return Err(Error::Internal("handles without a rig".into()));
        };
        let request = Request {
            transforms: &transforms,
            tolerance: settings.tolerance,
            max_error: settings.max_error,
            start: if mode == Mode::Drag { Start::Warm } else { Start::Fresh },
            first_pass: settings.first_pass,
            refinement: Refinement {
                steps: settings.refine.unwrap_or(match mode {
                    Mode::Drag => 0,
                    Mode::Commit => COMMIT_REFINE,
                }),
                smoothing: settings.rotation_smoothing,
            },
        };
        let shape = Shape {
            body,
            mesh,
            rest: &foundation.rest,
            handles,
        };
        let mut on_cycle = |cycle: &Cycle<'_>| {
            let positions = || shape.render(&(cycle.positions)(), &[], &transforms);
            watch(&Watch {
                cycle: u32::try_from(cycle.index).unwrap_or(u32::MAX),
                refined: cycle.refined,
                residual: cycle.residual,
                max_error: cycle.max_error,
                positions: &positions,
            })
        };
        let solution = match settings.spatial_rbf {
            true => rig.solve_in_space(body, &transforms, state, pool, progress)?,
            false => rig.solve(body, &request, state, pool, progress, &mut on_cycle)?,
        };
        Ok(Solved {
            positions: Arc::new(shape.render(&solution.positions, &solution.frames, &transforms)),
            cycles: u32::try_from(solution.iterations).unwrap_or(u32::MAX),
            residual: solution.residual,
            max_error: solution.max_error,
            solver: method_name(&solution),
        })
    }

    /// How far a shape (one position per render vertex) is from the rest shape.
    pub fn quality(&self, positions: &[DVec3], pool: &Pool) -> pb::Quality {
        quality(&self.mesh, self.report.closed, &self.welded(positions), pool)
    }

    /// As [`Workbench::quality`], with what `output` asks for beside: the number of self-intersections.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when `progress` says so.
    pub fn measure(
        &self,
        positions: &[DVec3],
        output: &pb::Output,
        pool: &Pool,
        progress: &dyn Progress,
    ) -> Result<pb::Quality, Error> {
        let deformed = self.welded(positions);
        let mut found = quality(&self.mesh, self.report.closed, &deformed, pool);
        if output.self_intersections {
            let pairs = self_intersections(&deformed, &self.mesh.triangles, pool, progress)?;
            found.self_intersections = Some(u32::try_from(pairs).unwrap_or(u32::MAX));
        }
        Ok(found)
    }

    /// Of positions of render vertices those of the solver's vertices.
    fn welded(&self, positions: &[DVec3]) -> Vec<DVec3> {
        let of = |s: u32| positions[self.mesh.render_vertices_of(s)[0] as usize];
        (0..self.mesh.positions.len() as u32).map(of).collect()
    }
}

/// From graph nodes back to render vertices.
struct Shape<'a> {
    body: &'a Body,
    mesh: &'a Mesh,
    rest: &'a [DVec3],
    handles: &'a HandleSet,
}

impl Shape<'_> {
    fn render(&self, nodes: &[DVec3], frames: &[[f32; 9]], transforms: &[Transform]) -> Vec<DVec3> {
        let at_rest = &self.body.graph.positions;
        let mut positions: Vec<DVec3> = self
            .rest
            .iter()
            .zip(&self.mesh.solver_from_render)
            .map(|(&rest, &solver)| {
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
            })
            .collect();
        for &(vertex, hold) in &self.handles.strays {
            if let Some(t) = transforms.get(hold as usize) {
                positions[vertex as usize] = t.map()(positions[vertex as usize]);
            }
        }
        positions
    }
}

fn estimate(vertices: u64, nodes: u64) -> u64 {
    vertices * BYTES_PER_VERTEX + nodes * BYTES_PER_NODE
}

fn admit(bytes: u64, limits: &Limits) -> Result<(), Error> {
    if bytes <= limits.memory_bytes {
        return Ok(());
    }
    Err(Error::TooLarge {
        what: "the estimated memory of the session in bytes",
        seen: bytes,
        limit: limits.memory_bytes,
    })
}

fn warnings_of(model: &Model, report: &Report) -> Vec<pb::Warning> {
    let read = model.warnings.iter().map(|(code, message, place)| pb::Warning {
        code: code.clone(),
        message: message.clone(),
        r#where: place.clone(),
    });
    let found = report.warnings.iter().map(|w| pb::Warning {
        code: w.code.into(),
        message: w.message.clone(),
        r#where: w.place.clone(),
    });
    read.chain(found).collect()
}

fn method_name(solution: &Solution) -> &'static str {
    use crate::deform::Method::{Graph, SpatialRbf};
    use crate::solver::Method as Solver;
    match solution.method {
        Graph(Solver::Trivial) => "trivial",
        Graph(Solver::Direct) => "direct",
        Graph(Solver::Multigrid) => "multigrid",
        Graph(Solver::PaperCycles) => "paper-cycles",
        Graph(Solver::ConjugateGradients) => "conjugate-gradients",
        SpatialRbf => "spatial-rbf",
    }
}

impl From<crate::deform::Error> for Error {
    fn from(e: crate::deform::Error) -> Self {
        use crate::deform::Error as Engine;
        match e {
            Engine::Cancelled => Self::Cancelled,
            Engine::Graph(_) => Self::invalid("volumeGraph", e.to_string()),
            Engine::NoInside => Self::invalid("volumeGraph.mode", e.to_string()),
            Engine::NoPosition | Engine::FreePart { .. } => Self::Precondition(e.to_string()),
            Engine::Unsupported(what) => Self::Unimplemented(what),
            Engine::Solver(_) => Self::Internal(e.to_string()),
        }
    }
}
