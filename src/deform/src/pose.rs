//! A pose that is to be solved: where the handles are, how exactly it is wanted and how it begins; and what comes of it.

use crate::body::DeformableBody;
use crate::first_pass::blend::{LocalFrame, LocalRotation};
use crate::rotation::Transform;
use glam::DVec3;
use pliant_solver::SolveMethod;

/// How exactly a pose is solved. All criteria that are given must hold.
///
/// ```
/// use pliant_deform::Quality;
/// let quality = Quality { tolerance: Some(1e-6), ..Quality::default() };
/// assert_eq!((quality.max_error, quality.refine), (None, None));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// Relative residual to reach (the paper's), when given.
    pub tolerance: Option<f64>,
    /// Largest missing displacement to reach, as a fraction of the diagonal, when given.
    pub max_error: Option<f64>,
    /// How often rotations are fitted after the second pass, with a solve after each. 0: the paper's two passes. `None`: as a
    /// deformer does in its mode and an animation from frame to frame; a [`HandleSystem`](crate::HandleSystem) fits none.
    pub refine: Option<u32>,
    /// What the mean rotation of a node's neighbours weighs in such a fit, relative to its own edges. 0: nothing.
    pub smoothing: f64,
    /// Whether poses that are solved from nothing and fitted keep the volume of the model, scaled as the handles are: what a twist
    /// or a pull would lose is given back across its sections. Without interior nodes nothing is kept.
    pub keeps_volume: bool,
}

impl Quality {
    /// What is solved for where nothing is asked for.
    pub const DEFAULT: Self = Self {
        tolerance: Some(1e-4),
        max_error: None,
        refine: None,
        smoothing: 0.0,
        keeps_volume: true,
    };
}

impl Default for Quality {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// How rotations are spread from the handles over the nodes.
#[derive(Debug, Clone, Copy, Default)]
pub enum FirstPass<'a> {
    /// Blended with bounded harmonic fields (the paper's choice, after Zayer et al. 2005). Any number of turns.
    #[default]
    Harmonic,
    /// Weighted sums of the quaternions of the few handles with a say at a node: little work, for animations, and blind to
    /// whole turns. What handles that constrain rotations alone do is taken whole where a solve starts from the last one.
    WeightedSum,
    /// These, one for each node, found in another way; `None` where nothing is turned.
    Given(Option<&'a [LocalRotation]>),
}

/// Where the solver starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolveStart {
    /// Full multigrid: the result depends on nothing but the request.
    Fresh,
    /// The last solution of the [`SolveState`](crate::SolveState), or the rest shape when there is none, carried along with the
    /// handles.
    Warm,
    /// The same, where what counts is the shape: fits begin with the rotations that fit best where it was carried to, and the pose is
    /// solved as exactly as from nothing.
    Shape,
}

impl SolveStart {
    /// Whether it is the last solution.
    pub(crate) fn is_last(self) -> bool {
        self != Self::Fresh
    }
}

/// Where fits of rotations begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FitOrder {
    /// Where a pose is solved from nothing, on the coarse levels of the solver, until the energy hardly falls, and then on the
    /// graph. Poses with smoothing, scales or soft rotations are fitted on the graph alone.
    #[default]
    CoarseFirst,
    /// On the graph alone.
    GraphAlone,
    /// For animations, on the graph alone: every fit goes further than to the rotation that fits best, and a warm solve that goes
    /// on from an earlier one's fits begins with a fit to where that one's solution was carried to. One fit a frame so comes as
    /// near to the minimum as two.
    Carried,
}

/// Which nodes a solution has positions and frames of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SolutionExtent<'a> {
    /// All.
    #[default]
    Graph,
    /// Positions of the surface at least, and frames of these nodes of it at least: for shapes that are shown.
    Surface(&'a [u32]),
}

/// A pose to solve.
#[derive(Debug, Clone, Copy)]
pub struct PoseRequest<'a> {
    /// By handle of the system.
    pub transforms: &'a [Transform],
    /// How exactly.
    pub quality: Quality,
    /// Where to start.
    pub start: SolveStart,
    /// How rotations are spread from the handles.
    pub first_pass: FirstPass<'a>,
    /// Where fits begin.
    pub fits: FitOrder,
    /// Which nodes the solution has.
    pub extent: SolutionExtent<'a>,
    /// Whether what is free leaves hard handles in their direction, where rotations are fitted.
    pub smooth_borders: bool,
}

impl<'a> PoseRequest<'a> {
    /// A pose that is solved from nothing, for all nodes.
    pub fn new(transforms: &'a [Transform], quality: Quality) -> Self {
        Self {
            transforms,
            quality,
            start: SolveStart::Fresh,
            first_pass: FirstPass::Harmonic,
            fits: FitOrder::default(),
            extent: SolutionExtent::default(),
            smooth_borders: false,
        }
    }

    /// How often rotations are fitted.
    pub(crate) fn steps(&self) -> u32 {
        self.quality.refine.unwrap_or(0)
    }
}

/// A state of a solve that is under way, given to the watcher after every cycle.
pub struct SolveUpdate<'a> {
    /// Cycles done, from 1.
    pub cycle: u32,
    /// Fits of rotations done.
    pub refined: u32,
    /// Relative residual reached, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// Makes the positions of this state, model space: of all nodes, or of the render vertices where a deformer solves. Costs
    /// a pass over them.
    pub positions: &'a dyn Fn() -> Vec<DVec3>,
}

/// How a pose was solved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseStats {
    /// Cycles of the position solve.
    pub cycles: u32,
    /// How often rotations were fitted; less than was asked for when the solve was cut short.
    pub refined: u32,
    /// Relative residual reached, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, fraction of the diagonal.
    pub max_error: f64,
    /// Name of the method that the solver ended with; empty where nothing was solved.
    pub solver: &'static str,
}

/// A solved pose, node by node.
#[derive(Debug, Clone)]
pub struct SolvedNodes {
    /// Positions of all graph nodes, or of at least the first ones with a smaller [`SolutionExtent`], model space; the
    /// first `graph.surface` are the mesh's vertices. Parts in which no handle has moved keep the bits of their rest
    /// positions.
    pub positions: Vec<DVec3>,
    /// Frames of the same nodes, of the first pass or as refined; empty when nothing moved. With [`SolutionExtent::Surface`] those that
    /// it does not name may be of other poses, and where it names none there may be none.
    pub frames: Vec<LocalFrame>,
    /// How it was solved.
    pub stats: PoseStats,
}

impl SolvedNodes {
    /// Nothing has moved.
    pub fn at_rest(body: &DeformableBody) -> Self {
        Self {
            positions: body.graph.positions.clone(),
            frames: Vec::new(),
            stats: PoseStats {
                solver: SolveMethod::Trivial.name(),
                ..PoseStats::default()
            },
        }
    }
}
