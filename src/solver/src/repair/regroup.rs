//! Coarsening what has lost its aggregates, by the rule that the whole level was coarsened by.
//! The new aggregates then receive rows of the next level.

use crate::build::coarsen::{WEAK, distance2};
use crate::build::draft::LevelDraft;
use crate::build::level::HierarchyLevel;
use crate::build::operator::coarse_weight;
use crate::build::order::along_curve;
use crate::lanes::{Lanes, WideLanes, add_wide};
use crate::repair::change::TouchedRows;
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
pub(super) fn regroup_members(level: &mut HierarchyLevel, placed: &PlacedRows) -> NewAggregates {
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
        let sequence = along_curve(&positions, Parallelism::single_threaded());
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

/// The rows that the groups of `level` become on `next`, in blocks of `block` rows.
pub(super) fn coarse_rows(
    level: &HierarchyLevel,
    next: &HierarchyLevel,
    groups: &NewAggregates,
    block: usize,
) -> TouchedRows {
    let NewAggregates { base, members, .. } = groups;
    let count = members.len();
    let placed = !level.positions.is_empty();
    let centroids: Vec<Lanes> = match placed {
        true => members.iter().map(|m| find_centroid(level, m)).collect(),
        false => Vec::new(),
    };
    let centre = |aggregate: u32| match aggregate.checked_sub(*base) {
        Some(g) => centroids[g as usize],
        None => next.positions[aggregate as usize],
    };

    // Each pair of groups is summed once, from the first of both, so the result is symmetric to the bit.
    let mut edges: Vec<Vec<(u32, f32)>> = vec![Vec::new(); count];
    // For each aggregate the group that met it last, in the upper half and from 1, and where its sum stands.
    let mut slots = vec![0u64; *base as usize + count];
    let mut sums: Vec<(u32, WideLanes)> = Vec::new();
    for (g, members) in members.iter().enumerate() {
        let own = base + g as u32;
        let mark = (g as u64 + 1) << 32;
        sums.clear();
        for &i in members {
            for (j, w) in level.row(i as usize) {
                let other = level.aggregates[j];
                if (*base..=own).contains(&other) || other == NO_ROW {
                    continue;
                }
                let w = f64::from(w);
                let mut term = match placed {
                    true => (level.positions[i as usize] - level.positions[j])
                        .to_wide()
                        .map(|d| d * w),
                    false => [0.0; 4],
                };
                term[3] = w;
                let slot = &mut slots[other as usize];
                if *slot >> 32 != mark >> 32 {
                    *slot = mark | sums.len() as u64;
                    sums.push((other, [0.0; 4]));
                }
                add_wide(&mut sums[*slot as u32 as usize].1, term);
            }
        }
        for &(other, sum) in &sums {
            let apart = placed.then(|| centre(own) - centre(other));
            let w = coarse_weight(apart, sum);
            edges[g].push((other, w));
            if let Some(other) = other.checked_sub(*base) {
                edges[other as usize].push((own, w));
            }
        }
    }

    let sequence = match placed {
        true => along_curve(&centroids, Parallelism::single_threaded()),
        false => (0..count as u32).collect(),
    };
    let mut places = vec![0u32; count];
    for (place, &g) in (0..).zip(&sequence) {
        places[g as usize] = place;
    }
    let padded = count.next_multiple_of(block);
    let (mut draft, mut foreign) = (LevelDraft::default(), Vec::new());
    let mut weights = Vec::new();
    draft.offsets.push(0);
    for &g in &sequence {
        for &(other, w) in &edges[g as usize] {
            draft.neighbours.push(match other.checked_sub(*base) {
                Some(other) => places[other as usize],
                None => {
                    foreign.push(other);
                    (padded + foreign.len() - 1) as u32
                }
            });
            weights.push(w);
        }
        draft.offsets.push(draft.neighbours.len() as u32);
        draft.positions.extend(centroids.get(g as usize));
    }
    draft.weights = Some(weights);
    TouchedRows {
        draft,
        foreign,
        origins: sequence.iter().map(|&g| groups.origins[g as usize]).collect(),
        dead: groups.dead.clone(),
        sequence,
    }
}

/// Mean position of `members`.
fn find_centroid(level: &HierarchyLevel, members: &[u32]) -> Lanes {
    let mut sum = [0.0; 4];
    for &i in members {
        add_wide(&mut sum, level.positions[i as usize].to_wide());
    }
    Lanes::from_wide(sum.map(|s| s / members.len() as f64))
}
