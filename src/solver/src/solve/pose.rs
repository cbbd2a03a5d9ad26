//! Poses of a drag: the second pass solved on the rows of the hierarchy, from one frame to the next, in single precision.
//!
//! A frame may leave work until it is out. Where earlier poses explain a pose well enough there is no iteration, and what is left of the residual adds up from frame to
//! frame until one of them needs a cycle and takes twice as long. Solved between frames, where a drag has time, it adds up no more.

use crate::build::hierarchy::Hierarchy;
use crate::build::level::HierarchyLevel;
use crate::constrain::system::LinearSystem;
use crate::error::Error;
use crate::lanes::{Lanes, NO_ROW, NumberWork, SLICE_ROWS, WIDTH, eight_wide, resize_untouched};
use crate::options::SolveStats;
use crate::solve::cycle::MultigridCycle;
use crate::solve::frame_rows::{FrameRows, PoseRow};
use crate::solve::group::{
    GroupOutcome, GroupSolve, IterationReport, LeftResidual, SolveControl, StoppingCriteria, Workspace,
};
use crate::solve::problem::ColumnGroup;
use crate::solve::solution_subspace::SolutionSubspace;
use crate::threads::Parallelism;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;

/// Rows that one piece of work handles.
const PIECE: usize = 256;

/// One pose on the rows of a hierarchy, and what a drag carries from one to the next.
///
/// Rows have the solver's order ([`Hierarchy::row_vertices`]): callers that fill them use memory in the order of the
/// solver, and nothing is reordered.
#[derive(Debug, Default)]
pub struct PoseRows {
    /// The linear map of each row, beside what the solver puts there.
    pub rows: Vec<PoseRow>,
    /// The rest position of each row, p.
    pub(super) rest: Vec<Lanes>,
    /// Σ w (p_i − p_j) of each row.
    pub(super) laplacians: Vec<Lanes>,
    /// Positions, in the units of the rest positions: given ones of fixed rows, the start of the others, and after a solve the
    /// solution. The last number of each is 0.
    pub x: Vec<[f64; 4]>,
    /// What is added to right-hand sides, in units of edge weights times positions; empty where nothing is.
    pub more: Vec<Lanes>,
    /// Rows whose rotation is fitted, for [`LinearSystem::start_pose`] and [`LinearSystem::fit_pose`].
    pub open: Vec<bool>,
    /// Whether the pose is one of a drag, whose corrections are remembered for the next ones.
    pub remember: bool,
    recalled: SolutionSubspace,
    /// What the last solve left to do, where it needed no iteration.
    pub(super) unsettled: Option<UnsettledPose>,
}

/// What a solve without iterations has left of its pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct UnsettledPose {
    pub(super) left: LeftResidual,
    /// The solve of the workspace that left it.
    pub(super) solve: u64,
    /// Residual or error over what was allowed, whichever is nearer.
    pub(super) nearness: f64,
}

/// A pose as a solve needs it: what residuals are made from, and what it changes.
pub(super) struct PoseParts<'a> {
    pub(super) frames: FrameRows<'a>,
    pub(super) x: &'a mut Vec<[f64; 4]>,
    pub(super) open: &'a [bool],
    recalled: &'a mut SolutionSubspace,
}

impl Hierarchy {
    /// The vertex of each row of the finest level; `u32::MAX` where a row holds none.
    pub fn row_vertices(&self) -> &[u32] {
        &self.order
    }
}

impl PoseRows {
    /// Sets rest positions and start positions, given by vertex, and sizes everything else; nothing of earlier poses is
    /// left. All maps are the identity.
    pub fn begin(
        &mut self,
        hierarchy: &Hierarchy,
        rest: impl Fn(usize) -> [f64; 3] + Sync,
        start: impl Fn(usize) -> [f64; 3] + Sync,
        pool: &Pool,
    ) {
        let level = &hierarchy.levels[0];
        let n = level.rows();
        self.recalled.forget();
        self.unsettled = None;
        self.more.clear();
        self.open.clear();
        resize_untouched(&mut self.x, n);
        resize_untouched(&mut self.rest, n);
        resize_untouched(&mut self.laplacians, n);
        resize_untouched(&mut self.rows, n);
        let at = |row: usize| match hierarchy.order[row] {
            NO_ROW => ([0.0; 3], [0.0; 3]),
            vertex => (rest(vertex as usize), start(vertex as usize)),
        };
        let threads = Parallelism::from_pool(pool).for_rows(n);
        threads.run_on(pool, || {
            let positions = (self.rest.as_mut_slice(), self.x.as_mut_slice());
            threads.for_each_piece(
                PIECE,
                (positions, self.rows.as_mut_slice()),
                |first, ((rest, x), rows)| {
                    for (((rest, x), row), i) in rest.iter_mut().zip(x).zip(rows).zip(first..) {
                        let ([a, b, c], [x0, x1, x2]) = at(i);
                        *rest = Lanes([a as f32, b as f32, c as f32, 0.0]);
                        *x = [x0, x1, x2, 0.0];
                        *row = PoseRow::IDENTITY;
                    }
                },
            );
            let rest = &self.rest;
            threads.for_each_piece(PIECE, self.laplacians.as_mut_slice(), |first, out| {
                let slices = out.as_chunks_mut::<SLICE_ROWS>().0.iter_mut();
                for (slice, out) in (first / SLICE_ROWS..).zip(slices) {
                    *out = differential_coordinates(level, rest, slice);
                }
            });
        });
    }

    /// Replaces maps and positions of rows by what `place` makes of them, and shows all positions to neighbours.
    pub fn place_rows<P: PlaceRows>(&mut self, pool: &Pool, place: &P) {
        self.unsettled = None;
        let threads = Parallelism::from_pool(pool).for_rows(self.rows.len());
        let Self { rows, rest, x, .. } = self;
        threads.run_on(pool, || {
            let n = rows.len().min(rest.len()).min(x.len());
            let vectors = (&mut rows[..n], &mut x[..n]);
            threads.map_pieces(PIECE, vectors, P::Scratch::default, |scratch, first, (rows, x)| {
                eight_wide(RowPiece {
                    place,
                    scratch,
                    first,
                    rows,
                    x,
                    rest: &rest[first..],
                });
            });
        });
    }

    pub(super) fn parts(&mut self, hierarchy: &Hierarchy) -> PoseParts<'_> {
        PoseParts {
            frames: FrameRows {
                rows: &self.rows,
                rest: &self.rest,
                laplacians: &self.laplacians,
                more: &self.more,
                scale: hierarchy.weight_scale as f32,
            },
            x: &mut self.x,
            open: &self.open,
            recalled: &mut self.recalled,
        }
    }

    /// Shows all positions to neighbours.
    pub fn show_positions(&mut self, pool: &Pool) {
        self.place_rows(pool, &RowsAsTheyAre);
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let rows =
            64 * self.rows.capacity() + 16 * (self.rest.capacity() + self.laplacians.capacity()) + self.open.capacity();
        rows + 32 * self.x.capacity() + 16 * self.more.capacity() + self.recalled.byte_size()
    }
}

/// What gives the rows of a pose their maps and positions.
pub trait PlaceRows: Sync {
    /// Memory of a thread.
    type Scratch: Default;

    /// Sets the maps of rows that lie side by side, from row `first` on, and replaces their positions; both four by four. Has to be
    /// `#[inline(always)]`.
    fn place(&self, scratch: &mut Self::Scratch, first: usize, rows: &mut [[PoseRow; 4]], x: &mut [[[f64; 4]; 4]]);
}

/// Leaves rows alone.
struct RowsAsTheyAre;

impl PlaceRows for RowsAsTheyAre {
    type Scratch = ();

    #[inline(always)]
    fn place(&self, (): &mut (), _: usize, _: &mut [[PoseRow; 4]], _: &mut [[[f64; 4]; 4]]) {}
}

/// Rows that lie side by side, to be placed and shown to their neighbours.
struct RowPiece<'a, P: PlaceRows> {
    place: &'a P,
    scratch: &'a mut P::Scratch,
    first: usize,
    rows: &'a mut [PoseRow],
    x: &'a mut [[f64; 4]],
    rest: &'a [Lanes],
}

impl<P: PlaceRows> NumberWork for RowPiece<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { rows, x, .. } = self;
        (self.place).place(self.scratch, self.first, rows.as_chunks_mut().0, x.as_chunks_mut().0);
        // In a turn of its own: what has just been written in pieces is slow to read as a whole.
        for ((row, x), rest) in rows.iter_mut().zip(x).zip(self.rest) {
            row.show(*rest, x);
        }
    }
}

/// Σ w (p_i − p_j) of the four rows of a bundle.
fn differential_coordinates(level: &HierarchyLevel, rest: &[Lanes], k: usize) -> [Lanes; SLICE_ROWS] {
    let (begin, _, end) = level.slice_extent(k);
    let filling = level.filling();
    let neighbours = level.neighbours[begin..end].as_chunks::<SLICE_ROWS>().0;
    let weights = level.weights.as_deref().map_or(&[][..], |w| &w[begin..end]);
    let weights = weights.as_chunks::<SLICE_ROWS>().0;
    let mut sums = [[0.0; WIDTH]; SLICE_ROWS];
    for (n, j) in neighbours.iter().enumerate() {
        for d in 0..SLICE_ROWS {
            let i = k * SLICE_ROWS + d;
            // Filling has weight 0: to itself, a row has no difference.
            let j = if j[d] == filling { i } else { j[d] as usize };
            let (here, there) = (rest[i].to_wide(), rest[j].to_wide());
            let w = weights.get(n).map_or(1.0, |w| f64::from(w[d]));
            (0..WIDTH).for_each(|c| sums[d][c] += w * (here[c] - there[c]));
        }
    }
    sums.map(Lanes::from_wide)
}

impl LinearSystem {
    /// Whether [`PoseEquations::solve`] can be asked: something is solved for by cycles, and every component is held.
    pub fn can_solve_poses(&self) -> bool {
        self.free_count() > 0 && !self.is_direct() && self.paper.is_none() && self.floating.is_empty()
    }

    /// Equation (8) on this system; `hierarchy` is the system's own. Nothing is checked before the equations are used.
    pub fn pose_equations<'a>(&'a self, hierarchy: &'a Hierarchy) -> PoseEquations<'a> {
        PoseEquations {
            system: self,
            hierarchy,
        }
    }
}

/// Equation (8) of the paper for the poses of a system; made by [`LinearSystem::pose_equations`].
#[derive(Debug, Clone, Copy)]
pub struct PoseEquations<'a> {
    system: &'a LinearSystem,
    hierarchy: &'a Hierarchy,
}

impl PoseEquations<'_> {
    /// Solves for the frames in `pose` from the positions in it, in three columns.
    ///
    /// `watch` is called after every iteration. What the corrections of the last few poses explain is taken out of the residual
    /// first; where that is enough there is no iteration, and the error is estimated from what iterations moved before. On most
    /// frames of a smooth drag it is.
    ///
    /// # Errors
    /// [`Error::Invalid`] where [`LinearSystem::can_solve_poses`] is false, for another hierarchy's system, or rows that do not fit;
    /// [`Error::Cancelled`]; [`Error::Diverged`] if nothing finite came out. Positions are then of no use.
    pub fn solve(
        &self,
        pose: &mut PoseRows,
        criteria: StoppingCriteria,
        workspace: &mut Workspace,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&IterationReport<'_>) -> SolveControl,
    ) -> Result<SolveStats, Error> {
        self.system.check_pose(self.hierarchy, pose)?;
        exec.check()?;
        pose.unsettled = None;
        let outcome = self.iterate(pose, criteria, workspace, exec, watch)?;
        let residuals: Vec<f64> = outcome.relative[..3].to_vec();
        Ok(SolveStats {
            iterations: outcome.iterations,
            residual: residuals.iter().fold(0.0, |a, &b| a.max(b)),
            residuals,
            max_error: outcome.max_error,
            factor: outcome.factor,
            method: outcome.method,
            stopped: outcome.stopped,
            converged: outcome.converged,
        })
    }

    /// Iterates on a pose that fits: from the residual that its last solve has left, or else from what it is.
    fn iterate(
        &self,
        pose: &mut PoseRows,
        criteria: StoppingCriteria,
        workspace: &mut Workspace,
        exec: &Exec<'_>,
        watch: &mut dyn FnMut(&IterationReport<'_>) -> SolveControl,
    ) -> Result<GroupOutcome, Error> {
        let Self { system, hierarchy } = *self;
        let left = pose.unsettled.take().map(|unsettled| unsettled.left);
        let remember = pose.remember;
        let PoseParts {
            frames, x, recalled, ..
        } = pose.parts(hierarchy);
        let threads = Parallelism::from_pool(exec.pool);
        let problem = ColumnGroup::of_pose(hierarchy, system, threads, frames);
        std::mem::swap(&mut workspace.x, x);
        let cycle = MultigridCycle {
            hierarchy,
            system,
            threads,
            progress: exec.progress,
        };
        let mut group = GroupSolve {
            problem,
            cycle,
            pool: exec.pool,
            criteria,
            workspace,
            caller: &[],
            from_zero: false,
            recalled: Some(recalled).filter(|_| remember),
            reached: None,
            left,
        };
        let solved = group.solve(watch);
        let GroupSolve {
            workspace,
            recalled,
            reached,
            left,
            ..
        } = group;
        exec.progress.begin_pass("recall");
        let mut unsettled = None;
        if let Some(recalled) = recalled {
            let is_left_alone = solved.as_ref().is_ok_and(|outcome| outcome.iterations == 0);
            match reached.filter(|_| solved.is_ok()) {
                Some(reached) => threads.run_on(exec.pool, || {
                    let r = workspace.fine.r.as_slice();
                    recalled.keep(&problem, r, reached.scale, reached.moved, reached.from_relative);
                }),
                None if is_left_alone => {
                    unsettled = solved.as_ref().ok().zip(left).map(|(outcome, left)| UnsettledPose {
                        left,
                        solve: workspace.solves,
                        nearness: criteria.nearness(&outcome.relative[..3], outcome.max_error),
                    });
                }
                None => recalled.forget(),
            }
        }
        std::mem::swap(&mut workspace.x, x);
        pose.unsettled = unsettled;
        solved
    }
}

impl LinearSystem {
    pub(super) fn check_pose(&self, hierarchy: &Hierarchy, pose: &PoseRows) -> Result<(), Error> {
        self.check_hierarchy(hierarchy)?;
        let n = hierarchy.order.len();
        let fits = [pose.rows.len(), pose.rest.len(), pose.laplacians.len(), pose.x.len()] == [n; 4]
            && (pose.more.is_empty() || pose.more.len() == n);
        match self.can_solve_poses() && fits && (pose.open.is_empty() || pose.open.len() == n) {
            true => Ok(()),
            false => Err(Error::Invalid("these rows are not a pose of this system".into())),
        }
    }
}

/// A pose is worth an iteration between frames from this part of what its solve allowed on: with less, iterations would come more
/// often than frames need them; with more, a frame would often need one before it can go out.
const WORTH_SETTLING: f64 = 0.3;

impl PoseRows {
    /// Whether the last solve, which needed no iteration, left enough for [`LinearSystem::settle_pose`] to be worth its time.
    pub fn is_worth_settling(&self) -> bool {
        (self.unsettled.as_ref()).is_some_and(|unsettled| unsettled.nearness > WORTH_SETTLING)
    }
}

impl LinearSystem {
    /// Takes one iteration on what the last [`PoseEquations::solve`] has left of the pose, if that is worth it; with the same
    /// `workspace`, or nothing is done. The solution becomes better, and the next pose begins from it.
    ///
    /// # Errors
    /// As [`PoseEquations::solve`]; after [`Error::Cancelled`] positions are still those of before.
    pub fn settle_pose(
        &self,
        hierarchy: &Hierarchy,
        pose: &mut PoseRows,
        workspace: &mut Workspace,
        exec: &Exec<'_>,
    ) -> Result<(), Error> {
        self.check_pose(hierarchy, pose)?;
        let Some(unsettled) = pose.unsettled.filter(|_| pose.is_worth_settling()) else {
            return Ok(());
        };
        if unsettled.solve != workspace.solves {
            pose.unsettled = None;
            return Ok(());
        }
        exec.check()?;
        let criteria = StoppingCriteria {
            tolerance: None,
            max_error: None,
            max_iterations: 1,
        };
        self.pose_equations(hierarchy)
            .iterate(pose, criteria, workspace, exec, &mut |_| SolveControl::Stop)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::{Constraints, InitialGuess, SolveOptions};
    use crate::testing::{BoxLattice, pool};
    use pliant_exec::progress::Silent;

    /// The map of a vertex: a turn about z that grows along x.
    fn map_of([x, ..]: [f64; 3], turn: f64) -> [f32; 9] {
        let (sine, cosine) = libm::sincosf((turn * x) as f32);
        [cosine, sine, 0.0, -sine, cosine, 0.0, 0.0, 0.0, 1.0]
    }

    fn times(m: &[f32; 9], e: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|r| (0..3).map(|c| f64::from(m[3 * c + r]) * e[c]).sum())
    }

    /// Equation (8)'s right-hand side, and `more` on top.
    fn right_hand_side(block: &BoxLattice, rest: &[[f64; 3]], maps: &[[f32; 9]], more: f64) -> Vec<f64> {
        let mut rhs = Vec::new();
        for i in 0..rest.len() {
            let mut sum = [more; 3];
            for e in block.offsets[i] as usize..block.offsets[i + 1] as usize {
                let j = block.neighbours[e] as usize;
                let w = block.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
                let edge: [f64; 3] = std::array::from_fn(|c| rest[i][c] - rest[j][c]);
                let (a, b) = (times(&maps[i], edge), times(&maps[j], edge));
                (0..3).for_each(|c| sum[c] += 0.5 * w * (a[c] + b[c]));
            }
            rhs.extend(sum);
        }
        rhs
    }

    #[test]
    fn poses_come_out_as_equations_do_with_fewer_and_fewer_iterations() {
        for weighted in [false, true] {
            let block = BoxLattice::new(24, 12, 12);
            let block = if weighted { block.weighted() } else { block };
            let rest: Vec<[f64; 3]> = block.positions.iter().map(|p| p.map(|v| v / 24.0)).collect();
            let hierarchy = block.hierarchy(60);
            let fixed: Vec<bool> = block.positions.iter().map(|p| p[0] == 0.0).collect();
            let stiffness: Vec<f64> = block
                .positions
                .iter()
                .map(|p| 0.5 * f64::from(u8::from(p[0] > 22.0)))
                .collect();
            let constraints = Constraints {
                fixed: &fixed,
                stiffness: Some(&stiffness),
            };
            let pool = pool();
            let system = hierarchy.constrain(&constraints, &pool).unwrap();
            assert!(system.can_solve_poses());
            let (mut workspace, mut other) = (Workspace::default(), Workspace::default());
            let exec = Exec::new(&pool, &Silent);
            let mut pose = PoseRows {
                remember: true,
                ..PoseRows::default()
            };
            pose.begin(&hierarchy, |v| rest[v], |v| rest[v], &pool);
            let mut iterations = Vec::new();
            // The last pose twice.
            for frame in 1..=13 {
                let turn = 0.05 * f64::from(frame.min(12));
                let maps: Vec<[f32; 9]> = rest.iter().map(|p| map_of(*p, turn)).collect();
                let n = hierarchy.row_vertices().len();
                pose.more.clear();
                pose.more.resize(n, Lanes::ZERO);
                for (row, &v) in hierarchy
                    .row_vertices()
                    .iter()
                    .enumerate()
                    .filter(|(_, v)| **v != NO_ROW)
                {
                    pose.rows[row].set_map(&maps[v as usize]);
                    pose.more[row] = Lanes([1e-3, 1e-3, 1e-3, 0.0]);
                }
                pose.show_positions(&pool);
                let criteria = StoppingCriteria {
                    tolerance: Some(1e-4),
                    max_error: None,
                    max_iterations: 50,
                };
                let watch = &mut |_: &IterationReport<'_>| SolveControl::Continue;
                let stats = system
                    .pose_equations(&hierarchy)
                    .solve(&mut pose, criteria, &mut workspace, &exec, watch)
                    .unwrap();
                assert!(stats.converged && stats.residual <= 1e-4, "{stats:?}");
                iterations.push(stats.iterations);

                let rhs = right_hand_side(&block, &rest, &maps, 1e-3);
                let mut exact: Vec<f64> = rest.concat();
                let options = SolveOptions {
                    start: InitialGuess::Given,
                    tolerance: Some(1e-10),
                    ..SolveOptions::default()
                };
                let equations = system.equations(&hierarchy, 3, &rhs);
                equations.solve(&mut exact, &options, &mut other, &exec, watch).unwrap();
                let mut farthest = 0.0f64;
                for (x, &v) in pose
                    .x
                    .iter()
                    .zip(hierarchy.row_vertices())
                    .filter(|(_, v)| **v != NO_ROW)
                {
                    let at = 3 * v as usize;
                    let far = (0..3).map(|c| (x[c] - exact[at + c]).powi(2)).sum::<f64>().sqrt();
                    farthest = farthest.max(far);
                }
                assert!(
                    farthest < 4.0 * stats.max_error + 1e-6 && farthest < 3e-4,
                    "{farthest:.1e}: {stats:?}"
                );
            }
            assert!(iterations[0] > 2, "{iterations:?}");
            assert!(
                iterations[6..12].iter().all(|&i| i <= 1) && iterations[12] == 0,
                "{iterations:?}"
            );
        }
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let block = BoxLattice::new(12, 10, 10);
        let hierarchy = block.hierarchy(60);
        let system = block.system(&hierarchy);
        let pool = pool();
        let exec = Exec::new(&pool, &Silent);
        let criteria = StoppingCriteria {
            tolerance: Some(1e-4),
            max_error: None,
            max_iterations: 50,
        };
        let mut workspace = Workspace::default();
        let mut solve = |pose: &mut PoseRows| {
            let watch = &mut |_: &IterationReport<'_>| SolveControl::Continue;
            system
                .pose_equations(&hierarchy)
                .solve(pose, criteria, &mut workspace, &exec, watch)
                .map(|stats| stats.iterations)
        };
        let mut pose = PoseRows::default();
        assert!(matches!(solve(&mut pose), Err(Error::Invalid(_))));
        pose.begin(&hierarchy, |v| block.positions[v], |_| [0.0; 3], &pool);
        pose.x[0] = [f64::INFINITY; 4];
        pose.x.iter_mut().for_each(|x| x[0] = 1e300);
        pose.show_positions(&pool);
        assert!(matches!(solve(&mut pose), Err(Error::Diverged { .. })));
    }
}
