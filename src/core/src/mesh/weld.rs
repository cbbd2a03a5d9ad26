//! Which vertices are one point: welding by equal coordinates or within a distance.
//!
//! Seams in a model's shading split one point into several render vertices; the solver must see one. Both ways give
//! each vertex the smallest index of its class, or of the class member that it was found close to, and depend on
//! nothing but the order of the input.

use crate::mesh::error::Error;
use glam::DVec3;

/// How render vertices are joined into solver vertices.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Weld {
    /// Vertices with the same coordinates to the bit are one (-0 and 0 are the same).
    #[default]
    Exact,
    /// Vertices no further apart than this length are one. Taken in order, each vertex joins the nearest earlier
    /// representative within the tolerance or becomes one, so representatives are always further apart than it.
    Tolerance(f64),
}

/// The representative (an index into `positions`, at most the vertex's own) of each vertex; representatives represent
/// themselves. Vertices for which `used` is false represent themselves and nobody else.
///
/// # Errors
/// [`Error::Tolerance`] when the tolerance is negative or not finite.
pub(super) fn representatives(positions: &[DVec3], used: &[bool], weld: Weld) -> Result<Vec<u32>, Error> {
    match weld {
        Weld::Exact => Ok(weld_equal(positions, used)),
        Weld::Tolerance(t) if !(t >= 0.0 && t.is_finite()) => Err(Error::Tolerance { seen: t }),
        Weld::Tolerance(t) => {
            let largest = positions
                .iter()
                .zip(used)
                .filter(|(_, used)| **used)
                .fold(0.0f64, |m, (p, _)| m.max(p.abs().max_element()));
            // Below the spacing of the coordinates a tolerance joins nothing but equal points.
            if t <= largest * f64::EPSILON {
                Ok(weld_equal(positions, used))
            } else {
                Ok(weld_close(positions, used, t))
            }
        }
    }
}

/// Coordinates as bits that are equal exactly when the numbers are.
fn position_bits_key(p: DVec3) -> [u64; 3] {
    // Adding zero turns -0 into 0 and changes nothing else.
    (p + DVec3::ZERO).to_array().map(f64::to_bits)
}

fn hash(key: [u64; 3]) -> u64 {
    key.iter().fold(0x9e37_79b9_7f4a_7c15, |h: u64, &k| {
        let x = (h ^ k).wrapping_mul(0xff51_afd7_ed55_8ccd);
        (x ^ (x >> 32)).wrapping_mul(0xc4ce_b9fe_1a85_ec53).rotate_left(29)
    })
}

/// Classes of equal coordinates: sorting by a hash brings them together, and each run of equal hashes is then sorted
/// by the coordinates themselves, so colliding hashes cost time but never correctness.
fn weld_equal(positions: &[DVec3], used: &[bool]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..positions.len() as u32).collect();
    let mut order: Vec<(u64, u32)> = parent
        .iter()
        .filter(|&&v| used[v as usize])
        .map(|&v| (hash(position_bits_key(positions[v as usize])), v))
        .collect();
    order.sort_unstable();
    for run in order.chunk_by_mut(|a, b| a.0 == b.0).filter(|run| run.len() > 1) {
        run.sort_unstable_by_key(|&(_, v)| (position_bits_key(positions[v as usize]), v));
        for class in run
            .chunk_by(|a, b| position_bits_key(positions[a.1 as usize]) == position_bits_key(positions[b.1 as usize]))
        {
            for &(_, v) in class {
                parent[v as usize] = class[0].1;
            }
        }
    }
    parent
}

/// The cell of a grid of side `2 · tolerance`. Numbers stay floating point, so that no coordinate overflows them.
fn grid_cell(p: DVec3, side: f64) -> [f64; 3] {
    (p / side).floor().to_array()
}

/// Greedy clusters. Points are sorted by grid cell once; each cell then keeps a growing list of its representatives.
fn weld_close(positions: &[DVec3], used: &[bool], tolerance: f64) -> Vec<u32> {
    let side = 2.0 * tolerance;
    let compare = |a: &[f64; 3], b: &[f64; 3]| {
        a[0].total_cmp(&b[0])
            .then_with(|| a[1].total_cmp(&b[1]))
            .then_with(|| a[2].total_cmp(&b[2]))
    };
    let mut cells: Vec<[f64; 3]> = positions
        .iter()
        .zip(used)
        .filter(|(_, used)| **used)
        .map(|(&p, _)| grid_cell(p, side))
        .collect();
    cells.sort_unstable_by(compare);
    cells.dedup();
    // Representatives of a cell form a chain: newest first in `head`, older ones through `older`.
    const END: u32 = u32::MAX;
    let mut head = vec![END; cells.len()];
    let mut older = vec![END; positions.len()];
    let mut parent: Vec<u32> = (0..positions.len() as u32).collect();
    for v in 0..positions.len() {
        if !used[v] {
            continue;
        }
        let p = positions[v];
        let home = grid_cell(p, side);
        // A ball of half a cell's side touches at most the two nearest cells along each axis.
        let beside: [f64; 3] = std::array::from_fn(|axis| {
            let inside = p[axis] / side - home[axis];
            if inside < 0.5 {
                home[axis] - 1.0
            } else {
                home[axis] + 1.0
            }
        });
        let mut best: Option<(f64, u32)> = None;
        let mut own = None;
        for corner in 0..8usize {
            let at: [f64; 3] = std::array::from_fn(|a| if corner >> a & 1 == 0 { home[a] } else { beside[a] });
            let Ok(index) = cells.binary_search_by(|c| compare(c, &at)) else {
                continue;
            };
            if corner == 0 {
                own = Some(index);
            }
            let mut other = head[index];
            while other != END {
                let distance = ((positions[other as usize] - p) / tolerance).length();
                if distance <= 1.0 && best.is_none_or(|(d, o)| (distance, other) < (d, o)) {
                    best = Some((distance, other));
                }
                other = older[other as usize];
            }
        }
        match (best, own) {
            (Some((_, representative)), _) => parent[v] = representative,
            (None, Some(index)) => {
                older[v] = head[index];
                head[index] = v as u32;
            }
            (None, None) => {}
        }
    }
    parent
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(positions: &[DVec3], weld: Weld) -> Vec<u32> {
        representatives(positions, &vec![true; positions.len()], weld).expect("a valid tolerance")
    }

    #[test]
    fn exact_welding_joins_equal_numbers_only() {
        let p = [
            [0.0, 1.0, 2.0],
            [-0.0, 1.0, 2.0],
            [0.0, 1.0, 2.0 + 1e-15],
            [0.0, 1.0, 2.0],
        ]
        .map(DVec3::from_array);
        assert_eq!(all(&p, Weld::Exact), [0, 0, 2, 0]);
    }

    #[test]
    fn vertices_that_no_triangle_uses_stay_apart() {
        let p = [DVec3::ZERO; 3];
        assert_eq!(
            representatives(&p, &[true, false, true], Weld::Exact),
            Ok(vec![0, 1, 0])
        );
        assert_eq!(
            representatives(&p, &[false, true, true], Weld::Tolerance(1.0)),
            Ok(vec![0, 1, 1])
        );
    }

    #[test]
    fn a_tolerance_does_not_chain() {
        let p: Vec<DVec3> = (0..10).map(|i| DVec3::new(i as f64 * 0.6, 0.0, 0.0)).collect();
        assert_eq!(all(&p, Weld::Tolerance(1.0)), [0, 0, 2, 2, 4, 4, 6, 6, 8, 8]);
    }

    #[test]
    fn the_grid_finds_what_a_search_over_all_finds() {
        let mut state = 7u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 40) as f64 / (1u64 << 24) as f64 - 0.5
        };
        let p: Vec<DVec3> = (0..800).map(|_| DVec3::new(next(), next(), next())).collect();
        for tolerance in [0.01, 0.07, 0.3, 5.0] {
            let mut expected: Vec<u32> = Vec::new();
            for v in 0..p.len() {
                let near = (0..v)
                    .filter(|&o| expected[o] == o as u32)
                    .map(|o| (((p[o] - p[v]) / tolerance).length(), o as u32))
                    .filter(|n| n.0 <= 1.0)
                    .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                expected.push(near.map_or(v as u32, |n| n.1));
            }
            assert_eq!(all(&p, Weld::Tolerance(tolerance)), expected, "tolerance {tolerance}");
        }
    }

    #[test]
    fn odd_tolerances_are_refused_or_harmless() {
        for t in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(representatives(&[DVec3::ZERO], &[true], Weld::Tolerance(t)).is_err());
        }
        let p = [DVec3::splat(1e30), DVec3::splat(-1e30), DVec3::splat(1e30)];
        assert_eq!(all(&p, Weld::Tolerance(1e-30)), [0, 1, 0]);
        assert_eq!(all(&p, Weld::Tolerance(1e300)), [0, 0, 0]);
        assert_eq!(all(&p, Weld::Tolerance(0.0)), [0, 1, 0]);
    }
}
