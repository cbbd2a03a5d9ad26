//! Neighbours in a body-centred cubic grid.
//!
//! Two cubic grids A and B of side `a`, B shifted by half a cell along each axis. Each node has six neighbours in its
//! own grid and eight in the other. A node is named by a key whose order is sheet by sheet, row by row.

use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// Name of a grid node: 20 bits each of z, then one bit for the grid (0 = A), then y and x.
pub(in crate::graph) type LatticeKey = u64;

/// Coordinates run from 1 to this, so that steps to a neighbour never leave their 20 bits.
pub(in crate::graph) const LAST: u32 = (1 << 20) - 2;

const AXIS: [LatticeKey; 3] = [1, 1 << 20, 1 << 41];
const IN_B: LatticeKey = 1 << 40;

pub(in crate::graph) fn key(at: [u32; 3], in_b: bool) -> LatticeKey {
    LatticeKey::from(at[0])
        + LatticeKey::from(at[1]) * AXIS[1]
        + LatticeKey::from(at[2]) * AXIS[2]
        + if in_b { IN_B } else { 0 }
}

/// Place of a node in grid units, from the place of A's node (0, 0, 0).
pub(in crate::graph) fn place(key: LatticeKey) -> DVec3 {
    let mask = (1 << 20) - 1;
    let coordinate = |shift: u32| ((key >> shift) & mask) as f64;
    let half = if key & IN_B == 0 { 0.0 } else { 0.5 };
    DVec3::new(coordinate(0), coordinate(20), coordinate(41)) + DVec3::splat(half)
}

/// The key of the neighbour in `direction`: 0 to 5 along the axes (+x, −x, +y, …), 6 to 13 in the other grid (bits of
/// `direction − 6`: towards +x, +y, +z).
pub(in crate::graph) fn toward(key: LatticeKey, direction: usize) -> LatticeKey {
    if direction < 6 {
        let axis = AXIS[direction / 2];
        return if direction.is_multiple_of(2) {
            key + axis
        } else {
            key - axis
        };
    }
    let bits = direction - 6;
    let along = |wanted: usize| {
        (0..3)
            .filter(move |axis| bits >> axis & 1 == wanted)
            .map(|axis| AXIS[axis])
            .sum::<LatticeKey>()
    };
    // A's node (i, j, k) lies half a cell below B's node of the same numbers along each axis.
    if key & IN_B == 0 {
        key + IN_B - along(0)
    } else {
        key - IN_B + along(1)
    }
}

#[cfg(test)]
fn opposite(direction: usize) -> usize {
    if direction < 6 {
        direction ^ 1
    } else {
        6 + (7 - (direction - 6))
    }
}

/// Directions that a lattice of the given valence (14 or 8) has.
pub(in crate::graph) fn directions(valence: u32) -> std::ops::Range<usize> {
    if valence == 8 { 6..14 } else { 0..14 }
}

/// In a [`LatticeRow`]: no neighbour.
pub(in crate::graph) const NONE: u32 = u32::MAX;
/// For a node the node in each of the 14 directions, or [`NONE`].
pub(in crate::graph) type LatticeRow = [u32; 14];

/// Nodes whose rows are found in one go.
const BLOCK: usize = 1 << 12;

/// The neighbours of each of the sorted `keys`. One pass over a block of keys per direction: the partner's key rises
/// with the node's.
pub(in crate::graph) fn rows(keys: &[LatticeKey], valence: u32, pool: &Pool) -> Vec<LatticeRow> {
    let mut rows = vec![[NONE; 14]; keys.len()];
    let fill = |(rows, block): (&mut [LatticeRow], &[LatticeKey])| {
        for direction in directions(valence) {
            // Steps from A and from B differ, and the partners of each rise on their own.
            for grid in [0, IN_B] {
                let mut own = rows.iter_mut().zip(block).filter(|(_, k)| *k & IN_B == grid).peekable();
                let Some((_, first)) = own.peek() else { continue };
                let wanted = toward(**first, direction);
                let mut partner = keys.partition_point(|&k| k < wanted);
                for (row, &key) in own {
                    let wanted = toward(key, direction);
                    while keys.get(partner).is_some_and(|&k| k < wanted) {
                        partner += 1;
                    }
                    if keys.get(partner) == Some(&wanted) {
                        row[direction] = partner as u32;
                    }
                }
            }
        }
    };
    pool.install(|| rows.par_chunks_mut(BLOCK).zip(keys.par_chunks(BLOCK)).for_each(fill));
    rows
}

/// The directions in the order of the neighbours' keys, for nodes of A and of B.
pub(in crate::graph) fn rising() -> [[usize; 14]; 2] {
    [false, true].map(|in_b| {
        let middle = key([LAST / 2; 3], in_b);
        let mut order: [usize; 14] = std::array::from_fn(|d| d);
        order.sort_by_key(|&d| toward(middle, d));
        order
    })
}

/// Whether a node belongs to grid B.
pub(in crate::graph) fn in_b(key: LatticeKey) -> bool {
    key & IN_B != 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(direction: usize) -> DVec3 {
        if direction < 6 {
            return DVec3::AXES[direction / 2] * [1.0, -1.0][direction % 2];
        }
        DVec3::from_array(std::array::from_fn(|axis| {
            if (direction - 6) >> axis & 1 == 1 { 0.5 } else { -0.5 }
        }))
    }

    #[test]
    fn steps_and_keys_agree_in_all_fourteen_directions() {
        for in_b in [false, true] {
            let here = key([7, 9, 11], in_b);
            for d in directions(14) {
                let there = toward(here, d);
                assert_eq!(place(there) - place(here), step(d), "direction {d}, in B: {in_b}");
                assert_eq!(toward(there, opposite(d)), here);
            }
        }
        assert_eq!(place(key([1, 2, 3], true)), DVec3::new(1.5, 2.5, 3.5));
    }

    #[test]
    fn pairs_are_those_at_neighbour_distance() {
        let mut keys: Vec<LatticeKey> = Vec::new();
        for n in 0..6 * 5 * 4 * 2u32 {
            if n % 7 != 3 {
                keys.push(key([1 + n % 6, 1 + n / 6 % 5, 1 + n / 30 % 4], n >= 120));
            }
        }
        keys.sort_unstable();
        for (valence, longest) in [(14, 1.0), (8, 0.9)] {
            let mut expected = Vec::new();
            for i in 0..keys.len() {
                for j in i + 1..keys.len() {
                    if place(keys[i]).distance(place(keys[j])) < longest + 1e-9 {
                        expected.push([i as u32, j as u32]);
                    }
                }
            }
            let rows = rows(&keys, valence, &Pool::new(2).expect("threads"));
            let mut found: Vec<[u32; 2]> = Vec::new();
            for (i, row) in (0u32..).zip(&rows) {
                found.extend(row.iter().filter(|&&j| j != NONE && j > i).map(|&j| [i, j]));
                for (d, &j) in row.iter().enumerate().filter(|r| *r.1 != NONE) {
                    assert_eq!(rows[j as usize][opposite(d)], i, "from {i} to {j} and back");
                }
                let order = rising()[usize::from(in_b(keys[i as usize]))];
                let along: Vec<u32> = order.iter().map(|&d| row[d]).filter(|&j| j != NONE).collect();
                assert!(along.is_sorted(), "{along:?} rises");
            }
            found.sort_unstable();
            assert_eq!(found, expected, "valence {valence}");
        }
    }
}
