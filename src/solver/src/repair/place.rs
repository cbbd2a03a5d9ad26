//! Moving rows of a level: touched ones to new blocks at its end, with updates of old neighbours.

use crate::build::draft::RowBlocks;
use crate::build::layout::append_rows;
use crate::build::level::{HierarchyLevel, SliceExtent};
use crate::lanes::Lanes;
use crate::repair::change::TouchedRows;
use crate::repair::marks::MarkedRows;
use crate::storage::{NO_ROW, SLICE_ROWS, grow};
use crate::threads::Parallelism;

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
