//! Coarsening what has lost its aggregates, by the rule that the whole level was coarsened by.

use crate::build::coarsen::{WEAK, distance2};
use crate::build::level::HierarchyLevel;
use crate::build::order::along_curve;
use crate::lanes::Lanes;
use crate::repair::place::PlacedRows;
use crate::storage::NO_ROW;
use crate::threads::Parallelism;

/// New aggregates of a level. Until they have rows, members of group `g` have the aggregate `base + g`.
#[derive(Debug)]
pub(super) struct NewAggregates {
    pub(super) base: u32,
    /// Rows of each group, the seed first.
    pub(super) members: Vec<Vec<u32>>,
    /// The row of the next level that each group replaces, or [`NO_ROW`].
    pub(super) origins: Vec<u32>,
    /// Rows of the next level that no longer stand for anything, rising: those replaced among them.
    pub(super) dead: Vec<u32>,
}

/// Dissolves the aggregates that a repair has broken and groups their rows and the new ones.
///
/// Their seeds, as far as they are left, come first, so that groups that the change hardly touches form again. Seeds of
/// other aggregates count too: rows that they cover need no seed, and may join them.
pub(super) fn regroup(level: &mut HierarchyLevel, placed: &PlacedRows) -> NewAggregates {
    let base = level.ranges.len() as u32;
    let broken = &placed.broken;
    let (rows, seeds) = free_rows(level, placed);
    for (k, &i) in (base..).zip(&rows) {
        level.aggregates[i as usize] = k;
    }
    let nearest = nearest_seeds(level, &rows, &seeds, base);

    // Groups of rows that are seeds in their order, then those that rows outside lead.
    let mut groups = NewAggregates {
        base,
        members: Vec::new(),
        origins: Vec::new(),
        dead: broken.clone(),
    };
    let mut group_of = vec![NO_ROW; rows.len()];
    for (k, &i) in rows.iter().enumerate() {
        if nearest[k] == i {
            group_of[k] = groups.members.len() as u32;
            groups.members.push(vec![i]);
            groups.origins.push(seeds[k]);
        }
    }
    let mut joined: Vec<u32> = Vec::new();
    for &seed in &nearest {
        let aggregate = level.aggregates[seed as usize];
        if aggregate < base {
            joined.push(aggregate);
        }
    }
    joined.sort_unstable();
    joined.dedup();
    let inner = groups.members.len() as u32;
    for &aggregate in &joined {
        groups.members.push(level.members_of(aggregate as usize).to_vec());
        groups.origins.push(aggregate);
    }
    groups.dead.extend(&joined);
    groups.dead.sort_unstable();
    for (k, &i) in rows.iter().enumerate() {
        let aggregate = level.aggregates[nearest[k] as usize];
        let group = match aggregate.checked_sub(base) {
            Some(seed) => group_of[seed as usize],
            None => inner + joined.partition_point(|&a| a < aggregate) as u32,
        };
        if nearest[k] != i {
            groups.members[group as usize].push(i);
        }
    }
    for (g, members) in (base..).zip(&groups.members) {
        for &i in members {
            level.aggregates[i as usize] = g;
        }
    }
    groups
}

/// Rows with neighbours and without aggregate, along the curve, and for those that are seeds of broken aggregates these
/// aggregates, else [`NO_ROW`]. Rows without neighbours lose their aggregate.
fn free_rows(level: &mut HierarchyLevel, placed: &PlacedRows) -> (Vec<u32>, Vec<u32>) {
    let mut successors: Vec<(u32, u32)> = placed
        .origins
        .iter()
        .copied()
        .zip(placed.rows.iter().copied())
        .collect();
    successors.sort_unstable();
    let successor = |row: u32| {
        let at = successors.binary_search_by_key(&row, |s| s.0).ok()?;
        Some(successors[at].1)
    };
    let mut seeds: Vec<(u32, u32)> = Vec::new();
    let mut rows: Vec<u32> = placed.rows.iter().chain(&placed.loose).copied().collect();
    for &aggregate in &placed.broken {
        let members = level.members_of(aggregate as usize);
        let stays = |i: &u32| level.aggregates[*i as usize] == aggregate;
        if let Some(&first) = members.first() {
            let seed = if stays(&first) { Some(first) } else { successor(first) };
            seeds.extend(seed.map(|s| (s, aggregate)));
        }
        rows.extend(members.iter().copied().filter(stays));
    }
    for &i in &rows {
        level.aggregates[i as usize] = NO_ROW;
    }
    rows.retain(|&i| level.connected(i as usize));
    if !level.positions.is_empty() {
        let positions: Vec<Lanes> = rows.iter().map(|&i| level.positions[i as usize]).collect();
        let sequence = along_curve(&positions, Parallelism::one());
        rows = sequence.into_iter().map(|k| rows[k as usize]).collect();
    }
    seeds.sort_unstable();
    let of_row = |&i: &u32| {
        let at = seeds.binary_search_by_key(&i, |s| s.0);
        at.map_or(NO_ROW, |at| seeds[at].1)
    };
    let seeds = rows.iter().map(of_row).collect();
    (rows, seeds)
}

/// The seed that each of `rows` joins, itself if it is one; the aggregate of row k of them is `base` + k. As in building
/// a level, but that those of `seeds` come before the others.
fn nearest_seeds(level: &HierarchyLevel, rows: &[u32], seeds: &[u32], base: u32) -> Vec<u32> {
    let placed = !level.positions.is_empty();
    let reach2 = level.grouping.reach2;
    let length2 = |i: u32, j: usize| match placed {
        true => distance2(level.positions[i as usize], level.positions[j]),
        false => 1.0,
    };
    let offer = |length2: f32, w: f32, seed: u32| {
        let cost = (length2 / w).min(f32::MAX);
        (u64::from(cost.to_bits()) + 1) << 32 | u64::from(seed)
    };
    let leads = |j: usize| {
        let aggregate = level.aggregates[j];
        aggregate < base && level.members_of(aggregate as usize).first() == Some(&(j as u32))
    };
    let near = |length2: f32| !placed || length2 <= reach2;
    let mut weak = Vec::with_capacity(rows.len());
    let (mut covered, mut offers) = (vec![false; rows.len()], vec![u64::MAX; rows.len()]);
    for (k, &i) in rows.iter().enumerate() {
        let limit = WEAK * level.row(i as usize).fold(0.0f32, |a, (_, w)| a.max(w));
        weak.push(limit);
        for (j, w) in level.row(i as usize).filter(|&(j, _)| leads(j)) {
            let length2 = length2(i, j);
            covered[k] |= near(length2) && w >= limit;
            offers[k] = offers[k].min(offer(length2, w, j as u32));
        }
    }
    for old in [true, false] {
        for (k, &i) in rows.iter().enumerate() {
            if covered[k] || (seeds[k] != NO_ROW) != old {
                continue;
            }
            offers[k] = u64::from(i);
            for (j, w) in level.row(i as usize) {
                let Some(other) = level.aggregates[j].checked_sub(base).map(|o| o as usize) else {
                    continue;
                };
                // Rows without neighbours have no aggregate, which is above all others; nor has any row them.
                if let Some(covered) = covered.get_mut(other) {
                    let length2 = length2(i, j);
                    *covered |= near(length2) && w >= weak[other];
                    offers[other] = offers[other].min(offer(length2, w, i));
                }
            }
        }
    }
    offers.into_iter().map(|offer| offer as u32).collect()
}
