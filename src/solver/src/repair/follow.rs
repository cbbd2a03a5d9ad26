//! Following a change from the finest level up.
//! Levels with many gaps are compacted, aggregates included.

use std::sync::Arc;

use crate::build::coarsen::SHRINK;
use crate::build::draft::{LevelDraft, RowBlocks, UnorderedRows};
use crate::build::draft::{along_curve, breadth_first};
use crate::build::hierarchy::{ArrangedDraft, Hierarchy, block_size, coarsen};
use crate::build::layout::arrange_rows;
use crate::build::level::HierarchyLevel;
use crate::error::Error;
use crate::graph::WeightedGraph;
use crate::lanes::{NO_ROW, grow};
use crate::repair::change::{GraphChange, RepairPlan, RepairReport, read_change};
use crate::repair::regroup::{NewAggregates, coarse_rows, regroup_members};
use crate::repair::regroup::{PlacedRows, place_rows};
use crate::threads::Parallelism;
use pliant_exec::Exec;
use pliant_exec::progress::Silent;

/// Levels above the first one with at most this many vertices are rebuilt, not repaired.
const SMALL: usize = 4096;
/// A level is rearranged once it holds this many times as many rows or entries as it uses,
const WASTE: usize = 2;
/// and this many more.
const WASTE_AT_LEAST: usize = 512;
/// Entries of a level beyond which repairs do not add to it.
const ROOM: usize = u32::MAX as usize / 4;

impl Hierarchy {
    /// Follows a topology change. `graph` is the graph after it, in the new numbers. Costs what the change touches, but
    /// for one pass over the numbers of all vertices; the result depends on the hierarchy and the arguments alone.
    ///
    /// [`LinearSystem`](crate::LinearSystem)s that were made before belong to the old hierarchy and fail with this one. To keep
    /// both, repair a clone.
    ///
    /// Weights keep the scale and positions the box that the hierarchy was built with. With
    /// [`CoarseOperators::Paper`](crate::CoarseOperators::Paper) a repair is a build.
    ///
    /// ```
    /// # use pliant_solver::GraphChange;
    /// # use pliant_exec::{Exec, pool::Pool, progress::Silent};
    /// # use pliant_solver::{BuildOptions, Constraints, Hierarchy, WeightedGraph};
    /// # let pool = Pool::new(1)?;
    /// # let exec = Exec::new(&pool, &Silent);
    /// # let chain = WeightedGraph { offsets: &[0, 1, 3, 5, 7, 8], neighbours: &[1, 0, 2, 1, 3, 2, 4, 3], weights: None, positions: None };
    /// let mut hierarchy = Hierarchy::build(&chain, &BuildOptions::default(), &exec)?;
    /// // The last vertex goes, and the one before it loses a neighbour.
    /// let shorter = WeightedGraph { offsets: &[0, 1, 3, 5, 6], neighbours: &[1, 0, 2, 1, 3, 2], ..chain };
    /// let change = GraphChange { new_from_old: &[0, 1, 2, 3, u32::MAX], touched: &[3] };
    /// let report = hierarchy.repair(&shorter, &change, &exec)?;
    /// assert!(report.rebuilt, "so small a graph is rebuilt");
    /// assert_eq!(hierarchy.vertices(), 4);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Invalid`] for a change that contradicts the graphs and for malformed touched rows,
    /// [`Error::Cancelled`]. The hierarchy is then as it was.
    pub fn repair(
        &mut self,
        graph: &WeightedGraph<'_>,
        change: &GraphChange<'_>,
        exec: &Exec<'_>,
    ) -> Result<RepairReport, Error> {
        self.repair_above(SMALL, graph, change, exec)
    }

    /// The same, with `small` in place of [`SMALL`].
    pub(super) fn repair_above(
        &mut self,
        small: usize,
        graph: &WeightedGraph<'_>,
        change: &GraphChange<'_>,
        exec: &Exec<'_>,
    ) -> Result<RepairReport, Error> {
        exec.check()?;
        let threads = Parallelism::from_pool(exec.pool);
        let least = self.vertices().min(graph.vertices());
        let full = |l: &crate::build::level::HierarchyLevel| l.neighbours.len() > ROOM || l.rows() > ROOM;
        let mut plan = None;
        if least > small && self.paper.is_none() && !self.levels.iter().any(full) {
            plan = threads.run_on(exec.pool, || read_change(self, graph, change, threads))?;
        }
        let Some(plan) = plan else {
            *self = Hierarchy::build(graph, &self.options, exec)?;
            return Ok(RepairReport {
                rebuilt: true,
                moved: 0,
            });
        };
        exec.check()?;
        let moved = threads.run_on(exec.pool, || self.follow_change(plan, small, threads));
        self.token = Arc::new(());
        Ok(RepairReport { rebuilt: false, moved })
    }

    /// True once repairs have left so much behind that a build pays off, because solves take about a quarter longer than
    /// after one: an eighth of the finest level's rows stands in blocks that were appended, a fifth is empty, or it holds
    /// a quarter as many unused entries as used ones. The number of iterations does not rise, and repairs still work:
    /// they rearrange a level of which more than half is unused.
    pub fn is_worn(&self) -> bool {
        let level = &self.levels[0];
        let (filling, rows, vertices) = (level.filling() as usize, level.rows(), level.occupied());
        let unused = level.neighbours.len() - level.entries;
        8 * (rows - filling) > rows || 5 * (rows - vertices) > rows || 4 * unused > level.entries
    }

    /// Changes the levels from the finest one up. Returns the number of rows that moved.
    fn follow_change(&mut self, plan: RepairPlan, small: usize, threads: Parallelism) -> usize {
        let RepairPlan {
            mut touched,
            vertices,
            order,
        } = plan;
        // The first level that is small; levels are repaired up to there.
        let top = self.levels.iter().position(|l| l.occupied() <= small);
        let top = top.unwrap_or(self.levels.len() - 1);
        self.order = order;
        let mut moved = 0;
        let mut groups: Option<NewAggregates> = None;
        for l in 0..=top {
            if touched.draft.rows() == 0 && touched.dead.is_empty() {
                break;
            }
            moved += touched.draft.rows();
            let sequence = std::mem::take(&mut touched.sequence);
            let placed = place_rows(&mut self.levels[l], touched, block_size(l), threads);
            match groups.take() {
                Some(groups) => self.adopt_members(l - 1, &groups, &sequence, &placed),
                None => self.name_vertices(&vertices, &placed),
            }
            let coarsened = self.levels.get(l + 1).map(|next| next.occupied());
            if l == top || self.levels[l].grouping.paired || coarsened.is_none() {
                self.coarsen_again(l, threads);
                break;
            }
            let (fine, coarse) = self.levels.split_at_mut(l + 1);
            let (level, next) = (&mut fine[l], &coarse[0]);
            let regrouped = regroup_members(level, &placed);
            let count = next.occupied() + regrouped.members.len() - regrouped.dead.len();
            if count as f64 > SHRINK * level.occupied() as f64 {
                self.coarsen_again(l, threads);
                break;
            }
            touched = coarse_rows(level, next, &regrouped, block_size(l + 1));
            groups = Some(regrouped);
        }
        for l in 0..self.levels.len().min(top + 1) {
            self.rearrange_if_wasteful(l, threads);
        }
        moved
    }

    /// Rearranges level `l` where most of it is unused.
    fn rearrange_if_wasteful(&mut self, l: usize, threads: Parallelism) {
        let level = &self.levels[l];
        let much = |all: usize, used: usize| all > WASTE * used + WASTE_AT_LEAST;
        if much(level.rows(), level.occupied()) || much(level.neighbours.len(), level.entries) {
            let (finer, coarser) = self.levels.split_at_mut(l);
            let level = &mut coarser[0];
            match finer.last_mut() {
                Some(finer) => {
                    let lives = |i: usize| !finer.members_of(i).is_empty();
                    let rank_of = rearrange_level(level, lives, block_size(l), threads);
                    renumber_aggregates(finer, &rank_of, level.rows());
                }
                None => {
                    let before = std::mem::take(&mut self.order);
                    let rank_of = rearrange_level(level, |i| before[i] != NO_ROW, block_size(l), threads);
                    self.order = vec![NO_ROW; level.rows()];
                    for (&rank, &vertex) in rank_of.iter().zip(&before).filter(|(rank, _)| **rank != NO_ROW) {
                        self.order[rank as usize] = vertex;
                    }
                }
            }
        } else if much(level.members.len(), level.occupied()) {
            gather_members(&mut self.levels[l], |i| i);
        }
    }

    /// Sets the vertices of new rows of the finest level.
    fn name_vertices(&mut self, vertices: &[u32], placed: &PlacedRows) {
        let level = &self.levels[0];
        let more = level.rows() - self.order.len();
        grow(&mut self.order, more, NO_ROW);
        for (&row, &vertex) in placed.rows.iter().zip(vertices) {
            self.order[row as usize] = vertex;
            let diagonal = f64::from(level.diagonal[row as usize]);
            self.largest_diagonal = self.largest_diagonal.max(diagonal);
        }
    }

    /// Sets the rows of new groups of level `l` in their members. Groups are in the order of `sequence`.
    fn adopt_members(&mut self, l: usize, groups: &NewAggregates, sequence: &[u32], placed: &PlacedRows) {
        let rows = self.levels[l + 1].rows();
        let level = &mut self.levels[l];
        for &row in &groups.dead {
            level.ranges[row as usize] = [0; 2];
        }
        let more = rows - level.ranges.len();
        grow(&mut level.ranges, more, [0; 2]);
        for (&g, &row) in sequence.iter().zip(&placed.rows) {
            let members = &groups.members[g as usize];
            let begin = level.members.len() as u32;
            grow(&mut level.members, members.len(), 0);
            level.members[begin as usize..].copy_from_slice(members);
            level.ranges[row as usize] = [begin, begin + members.len() as u32];
            for &i in members {
                level.aggregates[i as usize] = row;
            }
        }
    }

    /// Rebuilds all levels above level `l`.
    fn coarsen_again(&mut self, l: usize, threads: Parallelism) {
        self.levels.truncate(l + 1);
        let (finer, last) = self.levels.split_at_mut(l);
        let lives = |i: usize| match finer.last() {
            Some(finer) => !finer.members_of(i).is_empty(),
            None => self.order[i] != NO_ROW,
        };
        let level = &mut last[0];
        (level.aggregates, level.ranges, level.members) = Default::default();
        let (draft, ranks) = draft_of(level, lives, threads);
        let blocks = RowBlocks::new(&draft, block_size(l), threads);
        // Halfway through there is no way back, so cancelling is not checked.
        let last = ArrangedDraft { draft, blocks, ranks };
        let _ = coarsen(&mut self.levels, last, &self.options, threads, &Silent);
    }
}

/// The graph of a level in an order that keeps neighbours close, and the row of the level for each of its rows. `lives`
/// is true for rows that are not filling.
pub(super) fn draft_of(
    level: &HierarchyLevel,
    lives: impl Fn(usize) -> bool,
    threads: Parallelism,
) -> (LevelDraft, Vec<u32>) {
    let mut numbers = vec![NO_ROW; level.rows()];
    let mut rows = Vec::with_capacity(level.occupied());
    for i in (0..level.rows()).filter(|&i| lives(i)) {
        numbers[i] = rows.len() as u32;
        rows.push(i as u32);
    }
    let mut offsets = Vec::with_capacity(rows.len() + 1);
    offsets.push(0);
    let (mut neighbours, mut weights) = (Vec::with_capacity(level.entries), Vec::new());
    for &i in &rows {
        for (j, w) in level.row(i as usize) {
            neighbours.push(numbers[j]);
            if level.weights.is_some() {
                weights.push(w);
            }
        }
        offsets.push(neighbours.len() as u32);
    }
    let positions: Vec<_> = match level.positions.is_empty() {
        true => Vec::new(),
        false => rows.iter().map(|&i| level.positions[i as usize]).collect(),
    };
    let sequence = match positions.is_empty() {
        true => breadth_first(&offsets, &neighbours),
        false => along_curve(&positions, threads),
    };
    let graph = UnorderedRows {
        offsets: &offsets,
        neighbours: &neighbours,
        weights: level.weights.is_some().then_some(weights.as_slice()),
        scale: 1.0,
        positions: &positions,
    };
    let draft = LevelDraft::new(&graph, &sequence, threads);
    let rows = sequence.iter().map(|&k| rows[k as usize]).collect();
    (draft, rows)
}

/// Arranges `level` as if it had just been built; its aggregates stay the same. `lives` is true for rows that are not
/// filling. Returns the new row of each row, [`NO_ROW`] for filling.
pub(super) fn rearrange_level(
    level: &mut HierarchyLevel,
    lives: impl Fn(usize) -> bool,
    block: usize,
    threads: Parallelism,
) -> Vec<u32> {
    let (draft, rows) = draft_of(level, lives, threads);
    let blocks = RowBlocks::new(&draft, block, threads);
    let (mut fresh, ranks) = arrange_rows(&draft, &blocks, threads);
    let mut rank_of = vec![NO_ROW; level.rows()];
    for (&row, &rank) in rows.iter().zip(&ranks) {
        rank_of[row as usize] = rank;
    }
    fresh.grouping = level.grouping;
    if !level.aggregates.is_empty() {
        fresh.aggregates = vec![NO_ROW; fresh.rows()];
        for (&row, &rank) in rows.iter().zip(&ranks) {
            fresh.aggregates[rank as usize] = level.aggregates[row as usize];
        }
        fresh.ranges = std::mem::take(&mut level.ranges);
        fresh.members = std::mem::take(&mut level.members);
        gather_members(&mut fresh, |i| rank_of[i as usize]);
    }
    *level = fresh;
    rank_of
}

/// Renumbers the aggregates of `level` by `rank_of`, for a next level of `rows` rows.
pub(super) fn renumber_aggregates(level: &mut HierarchyLevel, rank_of: &[u32], rows: usize) {
    let mut ranges = vec![[0; 2]; rows];
    for (&rank, range) in rank_of.iter().zip(&level.ranges).filter(|(rank, _)| **rank != NO_ROW) {
        ranges[rank as usize] = *range;
    }
    level.ranges = ranges;
    gather_members(level, |i| i);
    for a in level.aggregates.iter_mut().filter(|a| **a != NO_ROW) {
        *a = rank_of[*a as usize];
    }
}

/// Brings the members of a level together in the order of their aggregates, under new numbers.
pub(super) fn gather_members(level: &mut HierarchyLevel, number: impl Fn(u32) -> u32) {
    let mut members = Vec::with_capacity(level.occupied());
    for range in &mut level.ranges {
        let begin = members.len() as u32;
        let here = &level.members[range[0] as usize..range[1] as usize];
        members.extend(here.iter().map(|&i| number(i)));
        *range = [begin, members.len() as u32];
    }
    level.members = members;
}
