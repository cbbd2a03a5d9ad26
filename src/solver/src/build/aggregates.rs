//! The rows of a level in groups, each of which becomes one row of the next level.

use crate::build::draft::LevelDraft;
use crate::storage::NO_ROW;
use crate::threads::{Parallelism, cut, piece_count, piece_rows};

/// Groups that one piece of work gathers.
const SEED_PIECE: usize = 1024;

/// Groups whose seeds' rows are asked of memory before they are needed.
const AHEAD: usize = 8;

/// How the rows of a level were grouped, which a repair goes on with.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct AggregationRule {
    /// Largest (squared) distance of neighbours of which only one can be a seed.
    pub(crate) reach2: f32,
    /// True if there are no seeds: see [`coarsen`](super::coarsen).
    pub(crate) paired: bool,
}

/// The rows of a [`LevelDraft`] in groups, each of which becomes one row of the next level.
#[derive(Debug, Default)]
pub(crate) struct Aggregates {
    /// Number of the group of each row, or [`NO_ROW`] for a row without neighbours.
    pub(crate) of_row: Vec<u32>,
    /// Where the members of each group begin; ends with their number.
    pub(crate) offsets: Vec<u32>,
    /// Rows by group; the seed, if there is one, comes first.
    pub(crate) members: Vec<u32>,
    pub(crate) grouping: AggregationRule,
}

impl Aggregates {
    /// Groups without seeds.
    pub(crate) fn new(of_row: Vec<u32>, count: usize) -> Aggregates {
        let mut offsets = vec![0u32; count + 1];
        for &g in &of_row {
            if g != NO_ROW {
                offsets[g as usize + 1] += 1;
            }
        }
        for k in 0..count {
            offsets[k + 1] += offsets[k];
        }
        let mut cursor = offsets.clone();
        let mut members = vec![0u32; offsets[count] as usize];
        for (i, &g) in of_row.iter().enumerate() {
            if g != NO_ROW {
                members[cursor[g as usize] as usize] = i as u32;
                cursor[g as usize] += 1;
            }
        }
        let grouping = AggregationRule {
            reach2: 0.0,
            paired: true,
        };
        Aggregates {
            of_row,
            offsets,
            members,
            grouping,
        }
    }

    /// Groups of seeds and neighbours that have joined them; `seeds` ascend. Only the rows of seeds are
    /// read.
    pub(crate) fn around(
        seeds: &[u32],
        of_row: Vec<u32>,
        reach2: f32,
        draft: &LevelDraft,
        threads: Parallelism,
    ) -> Aggregates {
        let count = seeds.len();
        let parts = threads.map(
            0..piece_count(count, SEED_PIECE),
            || (),
            |(), k| {
                let range = piece_rows(k, count, SEED_PIECE);
                let most: usize = seeds[range.clone()]
                    .iter()
                    .map(|&s| 1 + draft.entries(s as usize).len())
                    .sum();
                let mut members = vec![0u32; most];
                let mut ends = Vec::with_capacity(range.len());
                let mut used = 0;
                for group in range {
                    if let Some(&later) = seeds.get(group + AHEAD) {
                        draft.prefetch_row(later as usize);
                    }
                    let seed = seeds[group];
                    members[used] = seed;
                    used += 1;
                    // Whoever has not joined is written too, and then overwritten: that is faster than asking.
                    let row = draft.row(seed as usize);
                    for &j in row {
                        members[used] = j;
                        used += usize::from(of_row[j as usize] == group as u32);
                    }
                    ends.push(used as u32);
                }
                members.truncate(used);
                (members, ends)
            },
        );
        let mut offsets = Vec::with_capacity(count + 1);
        offsets.push(0);
        let mut base = 0;
        for (members, ends) in &parts {
            offsets.extend(ends.iter().map(|end| base + end));
            base += members.len() as u32;
        }
        let mut members = vec![0u32; base as usize];
        let members_of_parts = cut(&mut members, parts.iter().map(|(members, _)| members.len()));
        threads.for_each_item(members_of_parts, || (), |(), k, out| out.copy_from_slice(&parts[k].0));
        let grouping = AggregationRule { reach2, paired: false };
        Aggregates {
            of_row,
            offsets,
            members,
            grouping,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    #[inline(always)]
    pub(crate) fn members_of(&self, group: usize) -> &[u32] {
        &self.members[self.offsets[group] as usize..self.offsets[group + 1] as usize]
    }
}
