//! Rows of the next level for new aggregates.

use crate::build::draft::LevelDraft;
use crate::build::level::HierarchyLevel;
use crate::build::operator::coarse_weight;
use crate::build::order::along_curve;
use crate::lanes::{Lanes, WideLanes, add_wide};
use crate::repair::change::TouchedRows;
use crate::repair::regroup::NewAggregates;
use crate::storage::NO_ROW;
use crate::threads::Parallelism;

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
        true => members.iter().map(|m| centroid(level, m)).collect(),
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
                    true => (level.positions[i as usize] - level.positions[j]).wide().map(|d| d * w),
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
        true => along_curve(&centroids, Parallelism::one()),
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
fn centroid(level: &HierarchyLevel, members: &[u32]) -> Lanes {
    let mut sum = [0.0; 4];
    for &i in members {
        add_wide(&mut sum, level.positions[i as usize].wide());
    }
    Lanes::from_wide(sum.map(|s| s / members.len() as f64))
}
