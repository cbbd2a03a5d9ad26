//! Which vertices are one point: welding by equal coordinates, up to rounding, or within a distance.
//!
//! Seams in a model's shading split one point into several render vertices; the solver must see one. Every way gives
//! each vertex the smallest index of its class, or of the class member that it was found close to. The result
//! depends on the order of the input alone.

use crate::error::Error;
use glam::DVec3;

/// How render vertices are joined into solver vertices.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Weld {
    /// Vertices with exactly the same coordinates are one (-0 and 0 are the same).
    Exact,
    /// As [`Weld::Exact`]; vertices on open edges that differ by rounding are one as well. They are no further apart than
    /// 1e-7 of the bounding box's diagonal, and than a thousandth of the edges there. So a surface without open edges is
    /// welded exactly, and what is modelled finely stays.
    #[default]
    Rounding,
    /// Vertices no further apart than this length are one. Taken in order, each vertex joins the nearest earlier
    /// representative within the tolerance or becomes one, so representatives are always further apart than it.
    Tolerance(f64),
}

/// Vertices on open edges no further apart than this part of the box's diagonal differ by rounding: two 32-bit floats of half
/// that diagonal that are next to each other differ by 3e-8 to 6e-8 of it, along each of three axes.
const ROUNDING: f64 = 1e-7;
/// And no further than this part of the shortest edge at either: the details of a model are larger.
const OF_EDGE: f64 = 1e-3;

/// The representative (an index into `positions`, at most the vertex's own) of each vertex; representatives represent
/// themselves. Vertices for which `used` is false represent only themselves.
///
/// # Errors
/// [`Error::Invalid`] when the tolerance is negative or not finite.
pub(super) fn representatives(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    used: &[bool],
    weld: Weld,
) -> Result<Vec<u32>, Error> {
    match weld {
        Weld::Exact => Ok(weld_equal(positions, used)),
        Weld::Rounding => Ok(weld_rounded(positions, triangles, used)),
        Weld::Tolerance(t) if !(t >= 0.0 && t.is_finite()) => Err(Error::invalid(
            "weld tolerance",
            format!("is {t}, it must be finite and at least 0"),
        )),
        // Below the spacing of the coordinates a tolerance joins nothing but equal points.
        Weld::Tolerance(t) if t <= spacing(positions, used) => Ok(weld_equal(positions, used)),
        Weld::Tolerance(t) => Ok(weld_close(positions, used, t)),
    }
}

/// The spacing of the largest coordinate of the vertices that are used.
fn spacing(positions: &[DVec3], used: &[bool]) -> f64 {
    let used = positions.iter().zip(used).filter(|(_, used)| **used);
    used.fold(0.0f64, |m, (p, _)| m.max(p.abs().max_element())) * f64::EPSILON
}

/// Classes of equal coordinates, with those on open edges joined that differ by rounding.
fn weld_rounded(positions: &[DVec3], triangles: &[[u32; 3]], used: &[bool]) -> Vec<u32> {
    let mut parent = weld_equal(positions, used);
    let open = open_corners(triangles, &parent);
    if !open.contains(&true) {
        return parent;
    }
    let corners = positions.iter().zip(used).filter(|(_, used)| **used);
    let (low, high) = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (p, _)| {
        (low.min(*p), high.max(*p))
    });
    let tolerance = ROUNDING * low.distance(high);
    if tolerance <= spacing(positions, used) {
        return parent;
    }
    let near = weld_close(positions, &open, tolerance);
    let joined: Vec<(u32, u32)> = (0u32..).zip(near).filter(|(v, near)| v != near).collect();
    if joined.is_empty() {
        return parent;
    }
    let shortest = shortest_edges(positions, triangles, &parent, tolerance);
    for (v, near) in joined {
        let [from, to] = [v, near].map(|v| v as usize);
        let edge = shortest[from].min(shortest[to]);
        if edge.is_finite() && positions[from].distance(positions[to]) <= OF_EDGE * edge {
            parent[from] = near;
        }
    }
    for v in 0..parent.len() {
        parent[v] = parent[parent[v] as usize];
    }
    parent
}

/// By vertex: whether it represents its class (`parent`) and some edge there has not one triangle on each side.
fn open_corners(triangles: &[[u32; 3]], parent: &[u32]) -> Vec<bool> {
    // Around a closed fan every neighbour is once the next corner of a triangle and once the one before: marks of the
    // neighbours cancel.
    let mark = |v: u32| hash([u64::from(v), 1, 2]);
    let mut marks = vec![0u64; parent.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| parent[v as usize]);
        if a == b || b == c || c == a {
            continue;
        }
        for (v, next, before) in [(a, b, c), (b, c, a), (c, a, b)] {
            let sum = &mut marks[v as usize];
            *sum = sum.wrapping_add(mark(next)).wrapping_sub(mark(before));
        }
    }
    marks.into_iter().map(|sum| sum != 0).collect()
}

/// By vertex that represents its class: its shortest edge of those longer than `tolerance`; infinite where it has none.
fn shortest_edges(positions: &[DVec3], triangles: &[[u32; 3]], parent: &[u32], tolerance: f64) -> Vec<f64> {
    let mut shortest = vec![f64::INFINITY; parent.len()];
    for triangle in triangles {
        let corners = triangle.map(|v| parent[v as usize] as usize);
        for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (corners[a], corners[b])) {
            let length = positions[a].distance(positions[b]);
            if length > tolerance {
                shortest[a] = shortest[a].min(length);
                shortest[b] = shortest[b].min(length);
            }
        }
    }
    shortest
}

/// Coordinates as bits that are equal exactly when the numbers are.
fn position_bits_key(p: DVec3) -> [u64; 3] {
    // Adding zero turns -0 into 0 and changes nothing else.
    (p + DVec3::ZERO).to_array().map(f64::to_bits)
}

fn hash(key: [u64; 3]) -> u64 {
    key.iter().fold(0x9e37_79b9_7f4a_7c15, |h, &k| mix_bits(h, k))
}

/// Goes on with a hash by one more number.
pub fn mix_bits(hash: u64, number: u64) -> u64 {
    let x = (hash ^ number).wrapping_mul(0xff51_afd7_ed55_8ccd);
    (x ^ (x >> 32)).wrapping_mul(0xc4ce_b9fe_1a85_ec53).rotate_left(29)
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
        representatives(positions, &[], &vec![true; positions.len()], weld).expect("a valid tolerance")
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
            representatives(&p, &[], &[true, false, true], Weld::Exact),
            Ok(vec![0, 1, 0])
        );
        assert_eq!(
            representatives(&p, &[], &[false, true, true], Weld::Tolerance(1.0)),
            Ok(vec![0, 1, 1])
        );
    }

    /// A tetrahedron as loose triangles, each corner displaced by its own `shift`.
    fn loose_tetrahedron(size: f64, shift: impl Fn(usize) -> DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * size);
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let points = faces.as_flattened().iter().enumerate();
        let points = points.map(|(k, &v): (usize, &usize)| corners[v] + shift(k)).collect();
        (points, vec![[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]])
    }

    #[test]
    fn corners_that_differ_by_rounding_are_one_and_others_are_not() {
        let welded = |(p, t): (Vec<DVec3>, Vec<[u32; 3]>), weld| {
            let parent = representatives(&p, &t, &vec![true; p.len()], weld).expect("a way to weld");
            (0u32..).zip(parent).filter(|(v, r)| v == r).count()
        };
        let one = |by: f64| move |k: usize| DVec3::splat(if k == 7 { by } else { 0.0 });
        for size in [1e-3, 1.0, 1e6] {
            for (by, corners) in [(0.0, 4), (1e-17, 4), (3e-8, 4), (1e-6, 5)] {
                let shape = loose_tetrahedron(size, one(by * size));
                assert_eq!(welded(shape, Weld::Rounding), corners, "{by} of {size}");
            }
            let shape = loose_tetrahedron(size, one(3e-8 * size));
            assert_eq!(welded(shape, Weld::Exact), 5);
        }
        // A hole as small as what rounds in the model around it is a detail of the model.
        let (mut p, mut t) = loose_tetrahedron(1.0, |_| DVec3::ZERO);
        let (small, faces) = loose_tetrahedron(2e-8, |_| DVec3::ZERO);
        let first = p.len() as u32;
        p.extend(small.iter().map(|p| *p + DVec3::splat(0.1)));
        t.extend(faces[1..].iter().map(|f| f.map(|v| v + first)));
        let used: Vec<bool> = (0..p.len()).map(|v| t.as_flattened().contains(&(v as u32))).collect();
        assert_eq!(
            representatives(&p, &t, &used, Weld::Rounding),
            representatives(&p, &t, &used, Weld::Exact)
        );
    }

    #[test]
    fn a_closed_surface_is_welded_exactly_however_fine_it_is() {
        // Two closed parts that nearly touch.
        let (mut p, mut t) = loose_tetrahedron(1.0, |_| DVec3::ZERO);
        let first = p.len() as u32;
        p.extend(loose_tetrahedron(-1.0, |_| DVec3::splat(-1e-9)).0);
        t.extend([[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]].map(|f: [u32; 3]| f.map(|v| v + first)));
        let used = vec![true; p.len()];
        assert_eq!(
            representatives(&p, &t, &used, Weld::Rounding),
            representatives(&p, &t, &used, Weld::Exact)
        );
    }

    #[test]
    fn a_tolerance_does_not_chain() {
        let p: Vec<DVec3> = (0..10).map(|i| DVec3::new(i as f64 * 0.6, 0.0, 0.0)).collect();
        assert_eq!(all(&p, Weld::Tolerance(1.0)), [0, 0, 2, 2, 4, 4, 6, 6, 8, 8]);
    }

    #[test]
    fn the_grid_finds_what_a_search_over_all_finds() {
        let mut next = crate::testing::random(7);
        let p: Vec<DVec3> = (0..800)
            .map(|_| DVec3::new(next(), next(), next()) - DVec3::splat(0.5))
            .collect();
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
            assert!(representatives(&[DVec3::ZERO], &[], &[true], Weld::Tolerance(t)).is_err());
        }
        let p = [DVec3::splat(1e30), DVec3::splat(-1e30), DVec3::splat(1e30)];
        assert_eq!(all(&p, Weld::Tolerance(1e-30)), [0, 1, 0]);
        assert_eq!(all(&p, Weld::Tolerance(1e300)), [0, 0, 0]);
        assert_eq!(all(&p, Weld::Tolerance(0.0)), [0, 1, 0]);
    }
}
