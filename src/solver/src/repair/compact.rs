//! Levels without gaps: rearranges what repairs leave behind, aggregates included.

use crate::build::draft::{LevelDraft, RowBlocks, UnorderedRows};
use crate::build::layout::arrange_rows;
use crate::build::level::HierarchyLevel;
use crate::build::order::{along_curve, breadth_first};
use crate::storage::NO_ROW;
use crate::threads::Parallelism;

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
