//! Multigrid for the graph Laplacians of mesh deformation: a weighted graph, constraints, right-hand sides; no mesh.
//!
//! # The equations
//!
//! Both passes of the deformation end in the same kind of system (paper section 2.2 and equation (11)). For every
//! free vertex i,
//!
//! > Σ_j w_ij (x_i − x_j) + α_i x_i = b_i
//!
//! where x_j of a fixed vertex is given and α_i is the stiffness of a soft constraint. With b = 0 and fixed values
//! 0 and 1 the solution is one of the first pass's harmonic fields (equation (1)); with b_i = Σ_j w_ij d_ij it is the
//! second pass (equation (8)). The matrix is symmetric and, where every component is held somewhere, positive
//! definite. All columns (coordinates, fields) share it.
//!
//! # A hierarchy of graphs (paper sections 3 and 4)
//!
//! Relaxing one vertex after the other smooths the error within a few sweeps and then hardly reduces it: what is left
//! varies slowly. A graph with fewer vertices can represent it and passes information further with every sweep; a
//! hierarchy of ever coarser graphs does this on all scales, down to one that is solved directly.
//!
//! [`Hierarchy::build`] makes the levels. As in the paper, the *seeds* of the next level are a maximal δ-independent
//! set, found by one sweep: no two adjacent seeds are closer than δ = (mean edge length) · r^(−1/3). Constrained
//! vertices need no special treatment, and mesh connectivity is not kept. Where the paper keeps the seeds themselves
//! and connects those within two edges of each other, here each vertex *joins* the adjacent seed with the least
//! (distance² / weight), and the coarse vertex is the aggregate, at the centroid of its members.
//!
//! Edge weights between aggregates come from a finite-volume argument: the sum S of the crossing weights, times the
//! ratio φ of the flow that they carry under an affine field and the flow that one edge of weight S between the
//! centroids would carry, kept within 0.3 and 1. Every level thus has equations of the same form (12), and corrections
//! have the right size by construction. The paper's own operators, (14) with (19), prune the edges between vertices
//! that are not kept; on volume graphs that drops two thirds of them, and the cycle diverges. [`CoarseOperators::Paper`] selects
//! the paper's operators all the same, in the reading that comes closest to what it reports; see the page of `paper`.
//!
//! # Constraints come last
//!
//! The hierarchy holds *all* vertices. [`Hierarchy::constrain`] turns a set of constraints into masks: a fixed vertex
//! has correction 0 on every level, an aggregate of fixed vertices is itself fixed one level up, and one with free and
//! fixed members is tied by the weights between them, which become part of its α. So a new handle costs a fraction of
//! a build, and several [`LinearSystem`]s (one for the fields, one for the positions) share one hierarchy. Edges from the
//! free members of an aggregate to fixed ones of the same or of a fixed aggregate tie it with 0.6 of their weight: the
//! aggregate's members near the handle hardly move while the others do, and with the whole weight corrections around
//! tiny handles would be too short.
//!
//! # Topology may change
//!
//! [`Hierarchy::repair`] follows a graph whose vertices come and go, at a cost in proportion to the edit: rows that
//! change move to the end of their level, aggregates that lost a member are rebuilt by the same rule, old seeds first,
//! and so on level by level. All other aggregates stay. It converges as a fresh build does, within an iteration, also
//! after hundreds of edits.
//!
//! # Cycles and iterations (paper section 5)
//!
//! One cycle is a forward Gauss–Seidel sweep (equation (7)), a coarse correction of the defect equation (16), and a
//! backward sweep, which makes it symmetric. On coarse levels it is applied twice, as the preconditioner of two
//! conjugate-gradient steps (a K-cycle). On thin graphs (surfaces) the finest level is swept once more each way. The
//! paper found interleaving V-cycles with conjugate gradients a third
//! faster; here that is the rule: the whole cycle preconditions a flexible conjugate-gradient iteration in which all
//! columns go together, four at a time, each with its own step lengths. Cycles run in single precision; the residual
//! is renewed in double precision as often as needed to reach any tolerance that f64 allows.
//!
//! [`InitialGuess::FullMultigrid`] solves the original equations on the coarsest level first and brings the solution down
//! (the paper's figure 4). The affine prolongation (14) lives on in its patches: each coarse vertex carries its
//! members along, rotated and scaled.
//!
//! Every iteration estimates how far any vertex still is from the exact solution, so that a solve can stop at an error
//! in the user's units ([`SolveOptions::max_error`]) rather than at a residual. On graphs with geometry the estimate is
//! within a half and three times the truth from the second iteration on, until single precision runs out of digits.
//!
//! # Build, constrain, solve, repair
//!
//! | step | call | when | cost |
//! |---|---|---|---|
//! | build | [`Hierarchy::build`] | a new graph | about twenty products with the matrix |
//! | constrain | [`Hierarchy::constrain`] | other fixed vertices or stiffness | a fraction of a build |
//! | solve | [`LinearEquations::solve`] | another right-hand side or start | four to six products per iteration |
//! | drag | [`PoseEquations::solve`] | the next pose of a drag | two to four products, and now and then an iteration |
//! | repair | [`Hierarchy::repair`] | vertices or edges come and go | in proportion to the change |
//!
//! A [`Workspace`] carries all vectors from solve to solve. An [`Exec`](pliant_exec::Exec) joins the [`Pool`](pliant_exec::pool::Pool) that parallel
//! loops run on with the [`Progress`](pliant_exec::progress::Progress) that receives reports and can cancel the work: there are no
//! hidden threads, no clock and no global state. [`CholeskyFactor`] solves dense systems.
//!
//! # How rows are stored
//!
//! A sweep over irregular rows is bound by mispredicted branches and by waiting for memory, not by arithmetic. Rows follow
//! a space-filling curve, in blocks that stay in cache. Inside a block rows are coloured, and four rows of one colour
//! with nearly equal numbers of neighbours make a *slice* of a sliced ELLPACK format, whose entries are interleaved: one loop serves four rows,
//! and four independent sums are under way at any time. The places that are left over hold filling rows that nothing
//! refers to and entries of weight 0.
//!
//! When multigrid does not converge (weights over many orders of magnitude), plain conjugate gradients take over and
//! [`SolveStats::method`] says so. Up to 200 free vertices are solved directly.
//!
//! # Promises
//!
//! The same inputs give the same bits on any number of threads: blocks of rows are swept colour by colour in a fixed
//! order, and sums are formed in a fixed order. Once a [`Workspace`] has grown, solves allocate next to nothing. Fixed rows
//! are never written. No input makes the solver loop forever or produce NaN.
//!
//! # Example
//!
//! A chain of five vertices with both ends held, pulled apart in the first column and sagging under a load in the
//! second:
//!
//! ```
//! use pliant_exec::Exec;
//! use pliant_exec::pool::Pool;
//! use pliant_exec::progress::Silent;
//! use pliant_solver::{BuildOptions, Constraints, SolveControl, WeightedGraph, Hierarchy, SolveOptions, Workspace};
//!
//! let graph = WeightedGraph {
//!     offsets: &[0, 1, 3, 5, 7, 8],
//!     neighbours: &[1, 0, 2, 1, 3, 2, 4, 3],
//!     weights: None,
//!     positions: None,
//! };
//! let pool = Pool::new(1)?;
//! let hierarchy = Hierarchy::build(&graph, &BuildOptions::default(), &Exec::new(&pool, &Silent))?;
//! let ends = Constraints { fixed: &[true, false, false, false, true], stiffness: None };
//! let system = hierarchy.constrain(&ends, &pool)?;
//!
//! let rhs = [0.0, 0.0, 0.0, -1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 0.0];
//! let mut x = [0.0; 10];
//! x[8] = 4.0;
//! let options = SolveOptions { tolerance: Some(1e-9), ..SolveOptions::default() };
//! let mut workspace = Workspace::default();
//! let exec = Exec::new(&pool, &Silent);
//! let equations = system.equations(&hierarchy, 2, &rhs);
//! let stats = equations.solve(&mut x, &options, &mut workspace, &exec, &mut |_| SolveControl::Continue)?;
//! assert!(stats.converged);
//! let expected = [0.0, 0.0, 1.0, -1.5, 2.0, -2.0, 3.0, -1.5, 4.0, 0.0];
//! assert!(x.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-8));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]
// Kernels write rows from several threads; each place says why that is sound.
#![allow(unsafe_code)]

mod build;
mod constrain;
mod dense_inverse;
mod error;
mod graph;
mod lanes;
mod options;
mod paper;
mod repair;
mod solve;
#[cfg(test)]
mod testing;
mod threads;

pub use build::Hierarchy;
pub use constrain::LinearSystem;
pub use dense_inverse::CholeskyFactor;
pub use error::Error;
pub use graph::WeightedGraph;
pub use lanes::{Lanes, prefetch};
pub use options::{
    BuildOptions, CoarseOperators, Constraints, InitialGuess, LevelSize, SolveMethod, SolveOptions, SolveStats,
};
pub use repair::{GraphChange, RepairReport};
pub use solve::{
    IterationReport, LinearEquations, MapColumns, PlaceRows, PoseEquations, PoseRow, PoseRows, SolveControl,
    StoppingCriteria, Workspace,
};
