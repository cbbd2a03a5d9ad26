//! A pose that is to be solved, and what comes of it.

use crate::deform::body::DeformableBody;
use crate::deform::first_pass::frame::LocalFrame;
use crate::deform::first_pass::spread::FirstPass;
use crate::deform::second_pass::refine::Refinement;
use crate::deform::transform::Transform;
use crate::solver;
use glam::DVec3;

/// Where the solver starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolveStart {
    /// Full multigrid: the result depends on nothing but the request.
    Fresh,
    /// The last solution of the [`SolveState`], or the rest shape when there is none, carried along with the handles.
    Warm,
}

/// A pose to solve.
pub struct PoseRequest<'a> {
    /// By hold of the rig.
    pub transforms: &'a [Transform],
    /// Relative residual to reach (the paper's), when given.
    pub tolerance: Option<f64>,
    /// Largest missing displacement to reach, as a fraction of the diagonal, when given.
    pub max_error: Option<f64>,
    /// Where to start.
    pub start: SolveStart,
    /// How rotations are spread from the handles.
    pub first_pass: FirstPass,
    /// Fitting rotations after the second pass.
    pub refinement: Refinement,
    /// Which nodes the solution has.
    pub extent: SolutionExtent,
}

/// Which nodes a solution has positions and frames of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SolutionExtent {
    /// All.
    #[default]
    Graph,
    /// Positions of the surface at least, and frames where they cost nothing: for frames that are shown.
    Positions,
    /// Positions and frames of the surface at least.
    Surface,
}

/// A solve under way, after one iteration.
pub struct CycleReport<'a> {
    /// Iterations done, from 1.
    pub index: usize,
    /// How often rotations were fitted before this iteration.
    pub refined: u32,
    /// Relative residual, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// Makes the positions of all nodes, model space.
    pub positions: &'a dyn Fn() -> Vec<DVec3>,
}

/// A solved pose.
#[derive(Debug, Clone)]
pub struct PoseSolution {
    /// Positions of all graph nodes, or of at least the first ones with a smaller [`SolutionExtent`], model space; the
    /// first `graph.surface` are the mesh's vertices. Parts in which no handle has moved keep the bits of their rest
    /// positions.
    pub positions: Vec<DVec3>,
    /// Frames of the same nodes, of the first pass or as refined; empty when nothing moved, and where [`SolutionExtent::Positions`] does
    /// without them.
    pub frames: Vec<LocalFrame>,
    /// How often rotations were fitted; less than was asked for when the solve was cut short.
    pub refined: u32,
    /// Iterations of the solver.
    pub iterations: usize,
    /// Relative residual, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// How it was solved.
    pub method: PoseMethod,
}

/// How a pose was solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseMethod {
    /// By two passes on the graph, and how the solver ended.
    Graph(solver::SolveMethod),
    /// By radial basis functions in space.
    SpatialRbf,
}

impl PoseSolution {
    /// Nothing has moved.
    pub(in crate::deform) fn at_rest(body: &DeformableBody) -> Self {
        Self {
            positions: body.graph.positions.clone(),
            frames: Vec::new(),
            refined: 0,
            iterations: 0,
            residual: 0.0,
            max_error: 0.0,
            method: PoseMethod::Graph(solver::SolveMethod::Trivial),
        }
    }
}
