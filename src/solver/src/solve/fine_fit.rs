//! Rotations of a pose fitted to its positions, row by row, where right-hand sides are made from them.

use crate::build::level::HierarchyLevel;
use crate::lanes::{Lanes, prefetch};
use crate::solve::frame_rows::PoseRow;
use crate::solve::nearest_turn::{Turn, nearest_turns, turned};
use crate::storage::{NO_ROW, SLICE_ROWS};
use crate::threads::{Parallelism, piece_count, piece_rows};

/// Bundles that one piece of work handles.
const PIECE: usize = 256;

/// Turns the maps of open rows to fit the positions that rows show. Returns Σ w |x_i − x_j − M_i (p_i − p_j)|² over them.
pub(crate) fn fit_rows(
    level: &HierarchyLevel,
    (rows, rest): (&mut [PoseRow], &[Lanes]),
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
                let sums = bundle_sums(level, (read, rest), bundle);
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
    (rows, rest): (&[PoseRow], &[Lanes]),
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
