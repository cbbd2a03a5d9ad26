//! Coarsening what has lost its aggregates, by the rule that the whole level was coarsened by.
//! The new aggregates then receive rows of the next level.
//!
//! Moving rows of a level: touched ones to new blocks at its end, with updates of old neighbours.

use crate::build::coarsen::{WEAK, distance2};
use crate::build::draft::{LevelDraft, RowBlocks, along_curve};
use crate::build::layout::append_rows;
use crate::build::level::{HierarchyLevel, SliceExtent};
use crate::build::operator::coarse_weight;
use crate::lanes::{Lanes, NO_ROW, SLICE_ROWS, WideLanes, add_wide, grow};
use crate::repair::change::TouchedRows;
use crate::repair::marks::MarkedRows;
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

    // Each pair of groups is summed once, from the first of both, so the result is symmetric bit for bit.
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

/// Touched rows in their places.
#[derive(Debug)]
pub(super) struct PlacedRows {
    /// Rows in the order of the draft.
    pub(super) rows: Vec<u32>,
    /// The row that each has been, or [`NO_ROW`].
    pub(super) origins: Vec<u32>,
    /// Aggregates that have lost a member, rising.
    pub(super) broken: Vec<u32>,
    /// Rows that stay and have no aggregate but neighbours now.
    pub(super) loose: Vec<u32>,
}

/// Takes the rows that leave out of `level` and appends the touched ones.
///
/// A new row is swept after all old ones, and new blocks are not adjacent to others of their colour. Rows that border
/// on those that move stay where they are; only their entries are rewritten.
pub(super) fn place_rows(
    level: &mut HierarchyLevel,
    touched: TouchedRows,
    block: usize,
    threads: Parallelism,
) -> PlacedRows {
    let TouchedRows {
        draft,
        foreign,
        origins,
        dead,
        ..
    } = touched;
    let mut broken: Vec<u32> = match level.aggregates.is_empty() {
        true => Vec::new(),
        false => dead.iter().map(|&i| level.aggregates[i as usize]).collect(),
    };
    let mut border = MarkedRows::new(level.rows());
    for &i in &foreign {
        border.insert(i);
    }
    for &i in &dead {
        level.row(i as usize).for_each(|(j, _)| {
            border.insert(j as u32);
        });
    }
    dead.iter().for_each(|&i| border.remove(i));
    let border: Vec<u32> = border.iter().collect();
    clear_rows(level, &dead);

    let blocks = RowBlocks::new(&draft, block, threads);
    let mut rows = append_rows(level, &draft, &foreign, &blocks, threads);
    rows.truncate(draft.rows());
    if !level.aggregates.is_empty() {
        let more = level.rows() - level.aggregates.len();
        grow(&mut level.aggregates, more, NO_ROW);
    }
    let padded = blocks.padded() as u32;
    let mut added: Vec<(u32, u32, f32)> = Vec::with_capacity(foreign.len());
    for (k, &row) in rows.iter().enumerate() {
        for e in draft.entries(k) {
            if let Some(f) = draft.neighbours[e].checked_sub(padded) {
                added.push((foreign[f as usize], row, draft.weight(e)));
            }
        }
    }
    added.sort_unstable_by_key(|a| (a.0, a.1));
    add_to_border(level, &border, &added);

    let mut loose = Vec::new();
    if !level.aggregates.is_empty() {
        for &j in &border {
            let aggregate = level.aggregates[j as usize];
            match (level.connected(j as usize), aggregate) {
                (true, NO_ROW) => loose.push(j),
                (true, _) | (false, NO_ROW) => {}
                (false, _) => broken.push(aggregate),
            }
        }
    }
    broken.sort_unstable();
    broken.dedup();
    broken.retain(|&a| a != NO_ROW);
    PlacedRows {
        rows,
        origins,
        broken,
        loose,
    }
}

/// Turns the rows `dead` into filling.
fn clear_rows(level: &mut HierarchyLevel, dead: &[u32]) {
    let filling = level.filling();
    for i in dead.iter().map(|&i| i as usize) {
        let (begin, _, end) = level.slice_extent(i / SLICE_ROWS);
        for e in (begin + i % SLICE_ROWS..end).step_by(SLICE_ROWS) {
            level.neighbours[e] = filling;
            if let Some(w) = &mut level.weights {
                w[e] = 0.0;
            }
        }
        level.diagonal[i] = 0.0;
        if let Some(p) = level.positions.get_mut(i) {
            *p = Lanes::ZERO;
        }
        if let Some(a) = level.aggregates.get_mut(i) {
            *a = NO_ROW;
        }
        let k = i / SLICE_ROWS;
        if level.diagonal[k * SLICE_ROWS..(k + 1) * SLICE_ROWS] == [0.0; SLICE_ROWS] {
            level.bundles[k] = SliceExtent {
                begin: begin as u32,
                middle: begin as u32,
                end: begin as u32,
            };
            level.entries -= end - begin;
        }
    }
    level.occupied_rows -= dead.len();
}

/// Rewrites the entries of the rows of `border`, without those to rows that are now filling, and with those of `added`:
/// row, neighbour, weight. Both are sorted.
fn add_to_border(level: &mut HierarchyLevel, border: &[u32], added: &[(u32, u32, f32)]) {
    let filling = level.filling();
    let mut added = added.iter().copied().peekable();
    // Neighbours of each row of the bundle at hand, those before it and those after it.
    let mut sides: [[Vec<(u32, f32)>; 2]; SLICE_ROWS] = Default::default();
    for same in border.chunk_by(|a, b| a / SLICE_ROWS as u32 == b / SLICE_ROWS as u32) {
        let k = same[0] as usize / SLICE_ROWS;
        for (lane, sides) in sides.iter_mut().enumerate() {
            let i = (k * SLICE_ROWS + lane) as u32;
            sides.iter_mut().for_each(Vec::clear);
            let stays = |&(j, _): &(usize, f32)| level.connected(j);
            let kept = level.row(i as usize).filter(stays).map(|(j, w)| (j as u32, w));
            let more = std::iter::from_fn(|| added.next_if(|a| a.0 == i)).map(|(_, j, w)| (j, w));
            for entry in kept.chain(more) {
                sides[usize::from(entry.0 > i)].push(entry);
            }
        }
        for &i in same {
            let sides = &sides[i as usize % SLICE_ROWS];
            let sum: f64 = sides.iter().flatten().map(|e| f64::from(e.1)).sum();
            level.diagonal[i as usize] = sum as f32;
        }
        let width = |side: usize| sides.iter().map(|s| s[side].len()).max().unwrap_or(0) * SLICE_ROWS;
        let (before, size) = (width(0), width(0) + width(1));
        let old = level.bundles[k];
        let mut begin = old.begin as usize;
        if size > (old.end - old.begin) as usize {
            begin = level.neighbours.len();
            grow(&mut level.neighbours, size, filling);
            if let Some(w) = &mut level.weights {
                grow(w, size, 0.0);
            }
        }
        level.bundles[k] = SliceExtent {
            begin: begin as u32,
            middle: (begin + before) as u32,
            end: (begin + size) as u32,
        };
        level.entries = level.entries + size - (old.end - old.begin) as usize;
        level.neighbours[begin..begin + size].fill(filling);
        if let Some(w) = &mut level.weights {
            w[begin..begin + size].fill(0.0);
        }
        for (lane, sides) in sides.iter().enumerate() {
            for (side, first) in sides.iter().zip([begin, begin + before]) {
                for (&(j, weight), e) in side.iter().zip((first + lane..).step_by(SLICE_ROWS)) {
                    level.neighbours[e] = j;
                    if let Some(w) = &mut level.weights {
                        w[e] = weight;
                    }
                }
            }
        }
    }
}
