//! A pose begun from nothing, with rotations fitted on every level.
//! On the finest level the rotations of a pose are fitted to its positions row by row.

use crate::build::hierarchy::Hierarchy;
use crate::build::level::HierarchyLevel;
use crate::constrain::system::LinearSystem;
use crate::error::Error;
use crate::lanes::{Lanes, NO_ROW, SLICE_ROWS, prefetch};
use crate::solve::coarse_fits::CoarseFits;
use crate::solve::cycle::MultigridCycle;
use crate::solve::frame_rows::PoseRow;
use crate::solve::group::Workspace;
use crate::solve::patches::{Turn, nearest_turns, turned};
use crate::solve::pose::{PoseParts, PoseRows};
use crate::solve::problem::ColumnGroup;
use crate::solve::start::{StartMaps, full_multigrid};
use crate::threads::{Parallelism, piece_count, piece_rows};
use pliant_exec::Exec;

impl LinearSystem {
    /// Begins a pose from nothing: full multigrid, with the rotations of `pose.open`, if there are any, fitted on every coarse level
    /// until the energy hardly falls. Free rows of `pose.x` receive the start, and maps are turned as their aggregates have been.
    ///
    /// # Errors
    /// As [`PoseEquations::solve`](crate::PoseEquations::solve).
    pub fn start_pose(
        &self,
        hierarchy: &Hierarchy,
        pose: &mut PoseRows,
        workspace: &mut Workspace,
        exec: &Exec<'_>,
    ) -> Result<(), Error> {
        self.check_pose(hierarchy, pose)?;
        exec.check()?;
        exec.progress.begin_pass("start");
        pose.open.resize(pose.rows.len(), false);
        let PoseParts { frames, x, open, .. } = pose.parts(hierarchy);
        let threads = Parallelism::from_pool(exec.pool);
        let cycle = MultigridCycle {
            hierarchy,
            system: self,
            threads,
            progress: exec.progress,
        };
        let mut fits = open.contains(&true).then(|| CoarseFits::new(&cycle, open));
        let problem = ColumnGroup::of_pose(hierarchy, self, threads, frames);
        std::mem::swap(&mut workspace.x, x);
        let begun = problem.threads.run_on(exec.pool, || {
            full_multigrid(&problem, &cycle, StartMaps::Posed(frames), workspace, fits.as_mut())
        });
        let threads = problem.threads;
        std::mem::swap(&mut workspace.x, x);
        begun?;
        threads.run_on(exec.pool, || {
            if let Some(fits) = &fits {
                turn_rows(&hierarchy.levels[0], &mut pose.rows, &pose.open, fits.turns(), threads);
            }
        });
        pose.show_positions(exec.pool);
        Ok(())
    }

    /// Fits the rotations of `pose.open` to the positions in `pose.x`. Returns the energy of these rows before anything else moves:
    /// Σ w |x_i − x_j − M_i (p_i − p_j)|².
    ///
    /// # Errors
    /// As [`PoseEquations::solve`](crate::PoseEquations::solve).
    pub fn fit_pose(&self, hierarchy: &Hierarchy, pose: &mut PoseRows, exec: &Exec<'_>) -> Result<f64, Error> {
        self.check_pose(hierarchy, pose)?;
        exec.check()?;
        exec.progress.begin_pass("fit");
        pose.show_positions(exec.pool);
        let PoseRows { rows, rest, open, .. } = pose;
        open.resize(rows.len(), false);
        let threads = Parallelism::from_pool(exec.pool).for_rows(rows.len());
        Ok(threads.run_on(exec.pool, || fit_rows(&hierarchy.levels[0], rows, rest, open, threads)))
    }
}

/// Bundles that one piece of work handles.
const PIECE: usize = 256;

/// Turns the maps of open rows to fit the positions that rows show. Returns Σ w |x_i − x_j − M_i (p_i − p_j)|² over them.
pub(crate) fn fit_rows(
    level: &HierarchyLevel,
    rows: &mut [PoseRow],
    rest: &[Lanes],
    open: &[bool],
    threads: Parallelism,
) -> f64 {
    let bundles = rows.len() / SLICE_ROWS;
    let read = &*rows;
    // Neighbours read positions alone, but a row is one line of a cache: all maps are made before any is replaced.
    let fitted = threads.map(
        0..piece_count(bundles, PIECE),
        || (),
        |(), k| {
            let mut energy = 0.0;
            let mut maps = Vec::with_capacity(PIECE * SLICE_ROWS);
            for bundle in piece_rows(k, bundles, PIECE) {
                let first = bundle * SLICE_ROWS;
                if !(0..SLICE_ROWS).any(|d| open[first + d]) {
                    maps.extend((0..SLICE_ROWS).map(|d| read[first + d].columns()));
                    continue;
                }
                let sums = bundle_sums(level, read, rest, bundle);
                let turns = nearest_turns(sums.each_ref().map(|(columns, _)| columns));
                for (d, (turn, trace)) in turns.into_iter().enumerate() {
                    let map = read[first + d].columns();
                    if !open[first + d] {
                        maps.push(map);
                        continue;
                    }
                    let [x, y, z, _] = sums[d].1.to_wide();
                    energy += x + y + z - 2.0 * trace;
                    maps.push(turned(turn, &map));
                }
            }
            (energy, maps)
        },
    );
    const ROWS: usize = PIECE * SLICE_ROWS;
    threads.for_each_piece(ROWS, rows, |first, rows| {
        let maps = &fitted[first / ROWS].1;
        for ((row, map), _) in rows.iter_mut().zip(maps).zip(&open[first..]).filter(|(_, open)| **open) {
            row.set_columns(map);
        }
    });
    fitted.iter().map(|(energy, _)| energy).sum()
}

/// Σ w (x_i − x_j) (M_i (p_i − p_j))ᵀ by columns, and what squares come to, for the four rows of a bundle.
#[inline(always)]
fn bundle_sums(
    level: &HierarchyLevel,
    rows: &[PoseRow],
    rest: &[Lanes],
    bundle: usize,
) -> [([Lanes; 3], Lanes); SLICE_ROWS] {
    let (begin, _, end) = level.slice_extent(bundle);
    let first = bundle * SLICE_ROWS;
    let filling = level.filling();
    for j in level.later_neighbours(bundle) {
        prefetch(rows, j);
        prefetch(rest, j);
    }
    let mut sums: [([Lanes; 3], Lanes); SLICE_ROWS] = Default::default();
    let neighbours = level.neighbours[begin..end].as_chunks::<SLICE_ROWS>().0;
    for (n, j) in neighbours.iter().enumerate() {
        for d in 0..SLICE_ROWS {
            // Filling has weight 0: to itself, a row has no difference.
            let j = if j[d] == filling { first + d } else { j[d] as usize };
            let (here, other) = (&rows[first + d], &rows[j]);
            let mut edge = here.turned(rest[first + d] - rest[j]);
            edge.0[3] = 0.0;
            let flow = here.position() - other.position();
            let w = level.weight(begin + n * SLICE_ROWS + d);
            let weighted = flow * w;
            let (columns, squares) = &mut sums[d];
            for c in 0..3 {
                columns[c] += weighted * edge.0[c];
            }
            *squares += (edge * edge) * w + flow * weighted;
        }
    }
    sums
}

/// Turns the maps of open rows as their aggregates have been.
pub(crate) fn turn_rows(
    level: &HierarchyLevel,
    rows: &mut [PoseRow],
    open: &[bool],
    turns: &[Turn],
    threads: Parallelism,
) {
    threads.for_each_piece(PIECE, rows, |first, rows| {
        for (i, row) in (first..).zip(rows) {
            if open[i] && level.aggregates[i] != NO_ROW {
                row.set_columns(&turned(turns[level.aggregates[i] as usize], &row.columns()));
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::NO_ROW;
    use crate::options::Constraints;
    use crate::solve::group::{IterationReport, SolveControl, StoppingCriteria};
    use crate::testing::BoxLattice;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    const SLENDER: [i32; 3] = [40, 6, 6];
    /// Enough rows for several threads.
    const LARGE: [i32; 3] = [60, 14, 14];

    /// A long bar whose far end is carried sideways without being turned.
    struct BentBar {
        hierarchy: Hierarchy,
        system: LinearSystem,
        rest: Vec<[f64; 3]>,
        fixed: Vec<bool>,
        pool: Pool,
        workspace: Workspace,
    }

    impl BentBar {
        fn new(threads: usize, size: [i32; 3], is_weighted: bool) -> Self {
            let block = BoxLattice::new(size[0], size[1], size[2]);
            let block = if is_weighted { block.weighted() } else { block };
            let rest: Vec<[f64; 3]> = block
                .positions
                .iter()
                .map(|p| p.map(|v| v / f64::from(size[0])))
                .collect();
            let hierarchy = block.hierarchy(40);
            let fixed: Vec<bool> = rest.iter().map(|p| p[0] < 0.05 || p[0] > 0.95).collect();
            let constraints = Constraints {
                fixed: &fixed,
                stiffness: None,
            };
            let pool = Pool::new(threads).unwrap();
            let system = hierarchy.constrain(&constraints, &pool).unwrap();
            Self {
                hierarchy,
                system,
                rest,
                fixed,
                pool,
                workspace: Workspace::default(),
            }
        }

        fn pose(&self) -> PoseRows {
            let mut pose = PoseRows::default();
            pose.begin(&self.hierarchy, |v| self.rest[v], |v| self.rest[v], &self.pool);
            for (row, &v) in self.hierarchy.row_vertices().iter().enumerate() {
                pose.open.push(v != NO_ROW && !self.fixed[v as usize]);
                if v != NO_ROW {
                    let [x, y, z] = self.rest[v as usize];
                    let aside = if x > 0.95 { 0.4 } else { 0.0 };
                    pose.x[row] = [x - 0.3 * aside, y + aside, z, 0.0];
                }
            }
            pose.show_positions(&self.pool);
            pose
        }

        /// One solve, to a residual or by one iteration.
        fn solve(&mut self, pose: &mut PoseRows, tolerance: Option<f64>) {
            let criteria = StoppingCriteria {
                tolerance,
                max_error: None,
                max_iterations: 50,
            };
            let exec = Exec::new(&self.pool, &Silent);
            let watch = &mut |_: &IterationReport<'_>| match tolerance {
                Some(_) => SolveControl::Continue,
                None => SolveControl::Stop,
            };
            pose.show_positions(&self.pool);
            self.system
                .pose_equations(&self.hierarchy)
                .solve(pose, criteria, &mut self.workspace, &exec, watch)
                .unwrap();
        }

        fn fit(&self, pose: &mut PoseRows) -> f64 {
            let exec = Exec::new(&self.pool, &Silent);
            self.system.fit_pose(&self.hierarchy, pose, &exec).unwrap()
        }

        /// What is left after a start and two fits.
        fn fitted(&mut self) -> (PoseRows, f64) {
            let mut pose = self.pose();
            let exec = Exec::new(&self.pool, &Silent);
            self.system
                .start_pose(&self.hierarchy, &mut pose, &mut self.workspace, &exec)
                .unwrap();
            for tolerance in [None, None, Some(1e-4)] {
                self.solve(&mut pose, tolerance);
                if tolerance.is_none() {
                    self.fit(&mut pose);
                }
            }
            let energy = self.fit(&mut pose);
            (pose, energy)
        }
    }

    #[test]
    fn two_fits_after_a_fitted_start_come_nearer_to_the_minimum_than_ten_without() {
        for is_weighted in [false, true] {
            let mut bar = BentBar::new(1, SLENDER, is_weighted);
            let (_, energy) = bar.fitted();
            let mut pose = bar.pose();
            let mut energies = Vec::new();
            for _ in 0..100 {
                bar.solve(&mut pose, Some(1e-4));
                energies.push(bar.fit(&mut pose));
            }
            let least = energies.last().unwrap();
            assert!(energies[10] > 1.05 * least, "the bar is slender: {energies:?}");
            assert!(energy < 1.05 * least, "{energy} against {least}");
        }
    }

    #[test]
    fn threads_make_no_difference_to_fitted_poses() {
        let bits = |threads| {
            let (pose, energy) = BentBar::new(threads, LARGE, false).fitted();
            let x: Vec<u64> = pose.x.iter().flatten().map(|v| v.to_bits()).collect();
            (x, energy.to_bits())
        };
        let one = bits(1);
        assert!(bits(2) == one && bits(5) == one);
    }

    #[test]
    fn rotations_that_are_not_open_stay() {
        let mut bar = BentBar::new(1, SLENDER, false);
        let (pose, _) = bar.fitted();
        let maps = |pose: &PoseRows| -> Vec<[f32; 9]> { pose.rows.iter().map(|row| row.map()).collect() };
        let (before, after) = (maps(&bar.pose()), maps(&pose));
        let mut turned = 0;
        for ((before, after), open) in before.iter().zip(&after).zip(&pose.open) {
            assert!(*open || before == after);
            turned += usize::from(before != after);
        }
        assert!(turned > 1000);
    }
}
