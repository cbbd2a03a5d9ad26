//! Building the hierarchy: levels from fine to coarse, over all vertices, without constraints.

use std::sync::Arc;

use bytemuck::zeroed_vec;

use crate::build::coarsen::choose_aggregates;
use crate::build::draft::{LevelDraft, RowBlocks, UnorderedRows};
use crate::build::draft::{UnitBoxMap, along_curve, breadth_first};
use crate::build::layout::arrange_rows;
use crate::build::level::HierarchyLevel;
use crate::build::operator::coarse_rows;
use crate::error::Error;
use crate::graph::WeightedGraph;
use crate::lanes::{Lanes, SharedRows};
use crate::lanes::{NO_ROW, SLICE_ROWS};
use crate::options::{BuildOptions, CoarseOperators, LevelSize};
use crate::paper::level::UncutGraph;
use crate::threads::{Parallelism, piece_count, piece_rows};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::{Cancelled, Progress, check};

/// Rows per block on the finest level; halved from level to level.
const BLOCK: usize = 512;
/// Fewest rows per block.
const SMALLEST_BLOCK: usize = 64;
/// Vertices that one piece of work handles.
const PIECE: usize = 1 << 14;
/// Name of the stage that progress is reported under.
const STAGE: &str = "hierarchy";

/// A graph and its coarser versions (paper section 4), over all vertices and without constraints.
///
/// It owns all it needs and changes by nothing but [`Hierarchy::repair`]; any number of [`LinearSystem`](crate::LinearSystem)s can use it at the
/// same time.
#[derive(Debug, Clone)]
pub struct Hierarchy {
    /// Finest first; never empty.
    pub(crate) levels: Vec<HierarchyLevel>,
    /// Vertex that each row of the finest level stands for, none (`u32::MAX`) for filling.
    pub(crate) order: Vec<u32>,
    /// From the caller's positions to those of the levels.
    pub(crate) frame: UnitBoxMap,
    /// Factor on the caller's weights, a power of two: inside, the heaviest edge weighs 1 to 2.
    pub(crate) weight_scale: f64,
    /// Largest Σ w of a vertex, scaled.
    pub(crate) largest_diagonal: f64,
    /// Whether the graph has few neighbours per vertex; see [`is_thin`].
    pub(crate) thin: bool,
    /// What the hierarchy was built with.
    pub(crate) options: BuildOptions,
    /// Identifies the systems of this hierarchy.
    pub(crate) token: Arc<()>,
    /// With the paper's operators: the graph itself, to be cut by constraints and then coarsened.
    pub(crate) paper: Option<Arc<UncutGraph>>,
}

impl Hierarchy {
    /// Builds the hierarchy of `graph`. Linear time and memory; the result depends on nothing but the arguments, and
    /// on the pool not at all.
    ///
    ///
    /// ```
    /// # use pliant_exec::{Exec, pool::Pool, progress::Silent};
    /// # use pliant_solver::{BuildOptions, Constraints, Hierarchy, WeightedGraph};
    /// # let pool = Pool::new(1)?;
    /// # let exec = Exec::new(&pool, &Silent);
    /// # let chain = WeightedGraph { offsets: &[0, 1, 3, 5, 7, 8], neighbours: &[1, 0, 2, 1, 3, 2, 4, 3], weights: None, positions: None };
    /// let hierarchy = Hierarchy::build(&chain, &BuildOptions::default(), &exec)?;
    /// assert_eq!(hierarchy.level_sizes()[0].vertices, 5);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Invalid`] for a malformed graph or options out of range, [`Error::Cancelled`].
    pub fn build(graph: &WeightedGraph<'_>, options: &BuildOptions, exec: &Exec<'_>) -> Result<Hierarchy, Error> {
        if !(options.coarsening > 0.0 && options.coarsening <= 1.0) {
            let seen = options.coarsening;
            return Err(Error::Invalid(format!(
                "coarsening is {seen}, it must lie above 0 and be at most 1"
            )));
        }
        if !(1..=1000).contains(&options.coarsest) {
            let seen = options.coarsest;
            return Err(Error::Invalid(format!("coarsest is {seen}, allowed are 1 to 1000")));
        }
        if let Some(seen) = options.interleave.filter(|s| *s > 100) {
            return Err(Error::Invalid(format!("interleave is {seen}, at most 100 are allowed")));
        }
        exec.check()?;
        let threads = Parallelism::from_pool(exec.pool);
        threads.run_on(exec.pool, || graph.check_rows(threads))?;
        // Bundles hold up to four times as many entries as there are neighbours.
        let most = u32::MAX as usize / (2 * SLICE_ROWS);
        if graph.neighbours.len() > most {
            let seen = graph.neighbours.len();
            return Err(Error::Invalid(format!(
                "the graph has {seen} neighbours in all its rows, at most {most} are allowed"
            )));
        }
        exec.progress.report(STAGE, 0.0);

        let heaviest = graph.weights.map_or(1.0, |w| w.iter().fold(0.0f32, |a, &b| a.max(b)));
        let weight_scale = 1.0 / power_of_two_below(f64::from(heaviest));
        let frame = UnitBoxMap::around(graph.positions.unwrap_or(&[]));
        let positions = positions_in_box(&frame, graph.positions.unwrap_or(&[]), exec);
        let rows = UnorderedRows {
            offsets: graph.offsets,
            neighbours: graph.neighbours,
            weights: graph.weights,
            scale: weight_scale as f32,
            positions: &positions,
        };
        let (levels, order) = threads.run_on(exec.pool, || {
            let sequence = match positions.is_empty() {
                true => breadth_first(graph.offsets, graph.neighbours),
                false => along_curve(&positions, threads),
            };
            exec.check()?;
            let draft = LevelDraft::new(&rows, &sequence, threads);
            let (levels, ranks) = levels(draft, options, threads, exec.progress)?;
            let mut order = vec![NO_ROW; levels[0].rows()];
            let vertex_of = SharedRows::new(&mut order);
            threads
                .for_rows(ranks.len())
                .for_each(0..piece_count(ranks.len(), PIECE), |k| {
                    for i in piece_rows(k, ranks.len(), PIECE) {
                        // SAFETY: every vertex has its own row, and each is visited once.
                        unsafe { vertex_of.set(ranks[i] as usize, sequence[i]) };
                    }
                });
            Ok::<_, Cancelled>((levels, order))
        })?;
        exec.progress.report(STAGE, 1.0);
        let thin = is_thin(&levels[0]);
        let largest_diagonal = f64::from(levels[0].diagonal.iter().fold(0.0f32, |a, &b| a.max(b)));
        Ok(Hierarchy {
            levels,
            order,
            frame,
            weight_scale,
            largest_diagonal,
            thin,
            options: options.clone(),
            token: Arc::new(()),
            paper: (options.operators == CoarseOperators::Paper).then(|| Arc::new(UncutGraph::new(graph, options))),
        })
    }

    /// A copy, made by all threads of the pool.
    pub fn clone_in_parallel(&self, pool: &Pool) -> Self {
        let levels = pool.install(|| self.levels.iter().map(HierarchyLevel::clone_in_parallel).collect());
        Self {
            levels,
            order: self.order.clone(),
            options: self.options.clone(),
            token: Arc::clone(&self.token),
            paper: self.paper.clone(),
            ..*self
        }
    }

    /// What it was built with.
    pub fn options(&self) -> &BuildOptions {
        &self.options
    }

    /// Number of vertices of the graph.
    pub fn vertices(&self) -> usize {
        self.levels[0].occupied()
    }

    /// Sizes of the levels, finest first.
    pub fn level_sizes(&self) -> Vec<LevelSize> {
        let facts = |l: &HierarchyLevel| LevelSize {
            vertices: l.occupied(),
            edges: l.edge_count(),
        };
        // Where every component has shrunk to one vertex there is an empty last level.
        self.levels.iter().filter(|l| l.occupied() > 0).map(facts).collect()
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        let kept = self.paper.as_ref().map_or(0, |uncut| uncut.byte_size());
        self.levels.iter().map(HierarchyLevel::byte_size).sum::<usize>() + 4 * self.order.len() + kept
    }
}

/// Positions of vertices in the unit box.
fn positions_in_box(frame: &UnitBoxMap, positions: &[[f64; 3]], exec: &Exec<'_>) -> Vec<Lanes> {
    let n = positions.len();
    let threads = Parallelism::from_pool(exec.pool).for_rows(n);
    let mut placed: Vec<Lanes> = zeroed_vec(n);
    threads.run_on(exec.pool, || {
        threads.for_each_piece(PIECE, placed.as_mut_slice(), |first, out| {
            for (out, &p) in out.iter_mut().zip(&positions[first..]) {
                *out = frame.apply(p);
            }
        });
    });
    placed
}

/// Builds all levels from the finest one. Returns them and the row that each row of `draft` has become.
fn levels(
    draft: LevelDraft,
    options: &BuildOptions,
    threads: Parallelism,
    progress: &dyn Progress,
) -> Result<(Vec<HierarchyLevel>, Vec<u32>), Cancelled> {
    check(progress)?;
    let blocks = RowBlocks::new(&draft, block_size(0), threads);
    let (level, ranks) = arrange_rows(&draft, &blocks, threads);
    let mut levels = vec![level];
    let finest = ArrangedDraft {
        draft,
        blocks,
        ranks: ranks.clone(),
    };
    coarsen(&mut levels, finest, options, threads, progress)?;
    Ok((levels, ranks))
}

/// Rows per block of level `l`.
pub(crate) fn block_size(l: usize) -> usize {
    BLOCK.checked_shr(l as u32).unwrap_or(0).max(SMALLEST_BLOCK)
}

/// A draft that has become a level, which coarsening goes on from.
pub(crate) struct ArrangedDraft {
    pub(crate) draft: LevelDraft,
    pub(crate) blocks: RowBlocks,
    /// The row of the level that each row of the draft has become.
    pub(crate) ranks: Vec<u32>,
}

/// Adds all levels above the last of `levels`, which `arranged` has become.
pub(crate) fn coarsen(
    levels: &mut Vec<HierarchyLevel>,
    arranged: ArrangedDraft,
    options: &BuildOptions,
    threads: Parallelism,
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    let ArrangedDraft {
        mut draft,
        mut blocks,
        mut ranks,
    } = arranged;
    loop {
        // Level sizes fall geometrically, and so does the work that is left.
        progress.report(STAGE, 1.0 - 0.5f32.powi(levels.len() as i32));
        if draft.rows() <= options.coarsest {
            return Ok(());
        }
        check(progress)?;
        let groups = choose_aggregates(&draft, &blocks, options.coarsening, threads);
        check(progress)?;
        draft = coarse_rows(&draft, &groups, threads);
        check(progress)?;
        blocks = RowBlocks::new(&draft, block_size(levels.len()), threads);
        let (level, coarse_ranks) = arrange_rows(&draft, &blocks, threads);
        if let Some(last) = levels.last_mut() {
            last.set_aggregates(&groups, &ranks, &coarse_ranks, level.rows(), threads);
        }
        levels.push(level);
        ranks = coarse_ranks;
    }
}

/// True for graphs with few neighbours per row, such as those of surfaces. A sweep does less there and costs less:
/// twice as many pay (measured: 0.25 per iteration instead of 0.33 for a third more work; on volume graphs they do not).
fn is_thin(level: &HierarchyLevel) -> bool {
    const VALENCE: usize = 9;
    level.entries < VALENCE * level.occupied()
}

/// The largest power of two that is at most `v`, kept within 2^±1000; 1 unless `v` is positive and finite.
pub(crate) fn power_of_two_below(v: f64) -> f64 {
    if !(v > 0.0 && v.is_finite()) {
        return 1.0;
    }
    let v = v.clamp(libm::ldexp(1.0, -1000), libm::ldexp(1.0, 1000));
    f64::from_bits(v.to_bits() & 0x7ff0_0000_0000_0000)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::BoxLattice;

    #[test]
    fn aggregates_partition_the_rows() {
        let hierarchy = BoxLattice::new(15, 14, 13).hierarchy(10);
        assert!(
            hierarchy
                .levels
                .last()
                .is_some_and(|l| l.occupied() <= 10 && l.aggregates.is_empty())
        );
        for pair in hierarchy.levels.windows(2) {
            assert_eq!(pair[0].coarse_rows(), pair[1].rows());
            let mut seen = vec![false; pair[0].rows()];
            for row in 0..pair[1].rows() {
                for &i in pair[0].members_of(row) {
                    assert_eq!(pair[0].aggregates[i as usize], row as u32);
                    assert!(!std::mem::replace(&mut seen[i as usize], true));
                }
            }
            assert_eq!(seen.iter().filter(|s| **s).count(), pair[0].occupied());
        }
    }

    #[test]
    fn powers_of_two_are_kept_in_range() {
        assert_eq!(power_of_two_below(1.0), 1.0);
        assert_eq!(power_of_two_below(7.9), 4.0);
        assert_eq!(power_of_two_below(0.3), 0.25);
        assert_eq!(power_of_two_below(0.0), 1.0);
        assert_eq!(power_of_two_below(f64::NAN), 1.0);
        assert_eq!(power_of_two_below(f64::MAX), libm::ldexp(1.0, 1000));
        assert_eq!(power_of_two_below(f64::MIN_POSITIVE), libm::ldexp(1.0, -1000));
    }
}
