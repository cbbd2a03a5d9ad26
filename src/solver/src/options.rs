//! Inputs and outputs of solves: options, constraints, iterations, statistics.

/// Which coarse equations a hierarchy uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CoarseOperators {
    /// A finite-volume re-discretisation of the graph Laplacian on aggregates (see the module page). Needs no tuning.
    #[default]
    FiniteVolume,
    /// The operators of the paper's section 5.3, equations (14) to (22), for comparison. They converge slowly on volume
    /// graphs; conjugate gradients then finish the work and [`SolveStats::method`] says so. Constraints cost a whole build.
    Paper,
}

/// How to build a [`Hierarchy`](super::Hierarchy).
#[derive(Debug, Clone, PartialEq)]
pub struct BuildOptions {
    /// Which coarse equations to use.
    pub operators: CoarseOperators,
    /// The paper's r: seeds that are neighbours lie further apart than (mean edge length) · r^(−1/3). Above 0, at
    /// most 1. Smaller means fewer coarse vertices. Without positions it has no effect.
    pub coarsening: f64,
    /// Coarsening stops once a level has at most this many vertices; they are then solved directly. 1 to 1000.
    pub coarsest: usize,
    /// With [`CoarseOperators::Paper`]: conjugate-gradient steps after each V-cycle (the paper's section 6). `None` means as
    /// the paper recommends: two where a tolerance of 1e-5 or less is asked for, else none. At most 100.
    pub interleave: Option<usize>,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            operators: CoarseOperators::FiniteVolume,
            coarsening: 0.1,
            coarsest: 200,
            interleave: None,
        }
    }
}

/// Size of one level of a hierarchy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LevelSize {
    /// Vertices of the level, constrained ones included.
    pub vertices: usize,
    /// Undirected edges of the level.
    pub edges: usize,
}

/// Which vertices are given and which are pulled.
#[derive(Debug, Clone, Copy)]
pub struct Constraints<'a> {
    /// Per vertex: true if its value is given (hard constraint, the paper's C(i) of equation (11)).
    pub fixed: &'a [bool],
    /// Per vertex: extra diagonal α ≥ 0 of soft constraints, in units of the edge weights. Ignored on fixed vertices.
    pub stiffness: Option<&'a [f64]>,
}

/// Where the iteration begins.
#[derive(Debug, Clone, Copy, Default)]
pub enum InitialGuess<'a> {
    /// Free vertices begin at 0; what `x` holds there is not read.
    #[default]
    Zero,
    /// Free vertices begin at the values that `x` holds (a warm start, for example the last frame of a drag).
    Given,
    /// Solve the original equations on the coarsest level first and bring the solution down level by level (the
    /// paper's full multigrid). What `x` holds on free vertices is not read.
    FullMultigrid {
        /// Per vertex, fixed ones included: the linear map s_i R_i that equation (8)'s d_ij was assembled with,
        /// column-major. With it a coarse vertex carries its members along as an affine patch. Needs 3 columns.
        frames: Option<&'a [[f32; 9]]>,
        /// Rest positions that go with `frames`; `None` means those that the hierarchy was built with.
        rest: Option<&'a [[f64; 3]]>,
    },
}

/// When to stop and where to start. All criteria that are given must hold.
#[derive(Debug, Clone)]
pub struct SolveOptions<'a> {
    /// Where the iteration begins.
    pub start: InitialGuess<'a>,
    /// Largest ‖b − A x‖₂ / ‖b‖₂ of any column, where b is the right-hand side with fixed values moved into it
    /// (the paper's β of equation (11)).
    pub tolerance: Option<f64>,
    /// Largest estimated distance of any vertex from the exact solution, in the units of `x`, all columns together
    /// as one vector per vertex.
    pub max_error: Option<f64>,
    /// Most iterations for each group of four columns.
    pub max_iterations: usize,
}

impl Default for SolveOptions<'_> {
    fn default() -> Self {
        Self {
            start: InitialGuess::Zero,
            tolerance: Some(1e-4),
            max_error: None,
            max_iterations: 200,
        }
    }
}

/// Which algorithm produced the solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SolveMethod {
    /// Nothing was free.
    Trivial,
    /// Few enough free vertices for a dense factorisation.
    Direct,
    /// Conjugate gradients preconditioned by multigrid.
    Multigrid,
    /// The paper's V-cycles, with conjugate-gradient steps in between where asked for.
    PaperCycles,
    /// Conjugate gradients preconditioned by the diagonal, after multigrid had stagnated.
    ConjugateGradients,
}

impl SolveMethod {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trivial => "trivial",
            Self::Direct => "direct",
            Self::Multigrid => "multigrid",
            Self::PaperCycles => "paper-cycles",
            Self::ConjugateGradients => "conjugate-gradients",
        }
    }
}

/// What a solve did.
#[derive(Debug, Clone, PartialEq)]
pub struct SolveStats {
    /// Iterations of the group of columns that took most.
    pub iterations: usize,
    /// Relative residual, the largest column.
    pub residual: f64,
    /// Relative residual per column.
    pub residuals: Vec<f64>,
    /// Estimate of the largest distance of any vertex from the exact solution, in the units of `x`.
    pub max_error: f64,
    /// Observed reduction of the residual per iteration (geometric mean, slowest group); 0 without iterations.
    pub factor: f64,
    /// The algorithm (the last resort that any column needed).
    pub method: SolveMethod,
    /// True if `watch` asked to stop before the criteria held.
    pub stopped: bool,
    /// True if all criteria that were given hold.
    pub converged: bool,
}
