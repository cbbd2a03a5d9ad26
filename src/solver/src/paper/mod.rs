//! The paper's own multigrid: section 4's graphs, the operators (12) to (22), full multigrid, V(2,2) cycles.
//!
//! This module exists so that the method can be reproduced and compared. It is what
//! [`CoarseOperators::Paper`](super::CoarseOperators::Paper) selects. It stays close to the printed text, in double precision, with
//! sequential loops (so the bits cannot depend on the number of threads) and without the arrangements that make the
//! rest of the solver fast. All of it is linear in the size of the graph. It knows nothing of aggregates; the true
//! residual and the last resort come from the parent module, so that both are judged by the same measure.
//!
//! # Whose hierarchy
//!
//! The finest graph holds the *free* vertices only; constrained neighbours live on in α and β (equation (11)). A
//! [`PaperHierarchy`] therefore belongs to one set of constraints: unlike in the rest of the solver, a new handle costs
//! a whole build.
//!
//! # Two readings of one elimination
//!
//! Every level splits into elevated vertices and retained ones (index sets R and K). A retained vertex i is eliminated
//! after its couplings to other retained vertices have been simplified, and all of the paper's operators follow from
//! what stands in for those couplings, through one number, the pivot Z:
//!
//! | | prolongation | couplings within K | pivot | α of the coarse equations |
//! |---|---|---|---|---|
//! | [`OperatorReading::Pruned`] | (14) | removed | Z = Σ_R w + α | grows by w α / Z, (21) |
//! | [`OperatorReading::Held`] | (17) | their far ends stay at 0 | Z = Σ_N w + α | grows by w (α + Σ_K w) / Z |
//!
//! Substituting either prolongation into the equations of the elevated vertices gives equations of the same form (12)
//! with the weights (19). For (14) these are (18) to (22). For (17) the paper says only that "a corresponding
//! restriction operator" exists; carrying the substitution out as in (15) gives (19) with that row's pivot and the α of
//! the table. So original and defect equations have weights of their own on every coarse level, and since full
//! multigrid also runs cycles from the middle levels, whose fine equations are restricted originals, each level starts
//! a *chain* of defect equations. The graphs are shared; only numbers differ.
//!
//! # What to expect
//!
//! The restricted originals reproduce rigid motions exactly, so full multigrid begins with a small residual. The cycles
//! after it do little for the smooth part of the error. Holding the far ends at 0 ties every coarse vertex to 0 with
//! α about as large as its weights; a constant correction, the one that matters most, is almost suppressed. Once the
//! rough part of the error is gone the residual falls by 0.97 to 0.98 per cycle, on volume graphs and on surfaces. Other
//! literal readings are worse: with the pruned pivot for defects as well, cycles diverge by factors of 10 and more on
//! volume graphs, because pruning drops two thirds of the edges and the coarse graph becomes too soft; (17) with the
//! weights of (19) as printed does no better than 0.93 on small ones and diverges on large ones. The tests beside this
//! module record these factors. On paths, where retained vertices have no retained neighbours, all readings agree and
//! one cycle is exact.
//!
//! Full multigrid runs one cycle on each level on its way up, as in figure 4. The text asks for "an accurate solution"
//! on each level instead; thirty cycles give an error that is several times smaller at the start, still about a percent
//! of the box, and the same factors afterwards.
//!
//! Therefore the iteration watches itself. When twelve cycles fail to halve the residual, when it grows, or when
//! at this pace the tolerance is out of reach, conjugate gradients take over and the statistics say so.
//!
//! # Slips in the print
//!
//! - The text after (16) gives ζ_i with Σ w (x_j − x_i − d_ji); the defect of (12) has x_i − x_j − d_ji.
//! - Before (15), "eliminate x_j" must read x_i, and before (17), Δx_i for j ∈ K(i) must read Δx_j.
//! - (20) and (22) are right as printed if d_kj stands for x_j − x_k, which is how (18) uses it.
//!
//! # Choices that the paper leaves open
//!
//! - The sweep for seeds runs in storage order, except that vertices of more than 64 neighbours come first. Were such a
//!   hub retained, all its seeds would be joined to each other.
//! - Two coarse vertices are joined where (19) gives a weight: by an edge, or over a common retained vertex. Paths over
//!   a third seed make a 2-ring too, but no weight.
//! - A vertex without neighbours is solved on its own level and not elevated.
//! - The coarsest level has at most [`BuildOptions::coarsest`](super::BuildOptions::coarsest) vertices and is solved by
//!   a dense inverse; the paper used a sparse factor and stopped at 2000 to 2500.
//! - The paper does not name the preconditioner of the two conjugate-gradient steps that may follow a cycle. Here it is
//!   a symmetric Gauss–Seidel sweep.

pub(crate) mod hierarchy;
mod iterate;
pub(crate) mod level;
mod restrict;
mod smooth;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

pub(crate) use self::iterate::solve;
