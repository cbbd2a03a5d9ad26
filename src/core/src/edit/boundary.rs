//! The boundary of a whole surface, found without sorting its edges.

use super::surface::SurfaceView;
use std::collections::BTreeMap;

/// The points where an edge has more faces on one side than on the other, rising.
///
/// One flat scan: over the faces around a point of the inside, each neighbour comes once after it and once before it,
/// so that sums of scrambled numbers cancel. That they cancel by chance is as good as impossible.
pub(super) fn boundary_points(surface: &SurfaceView<'_>) -> Vec<u32> {
    let sums = unmatched_neighbours(surface);
    let open = sums.iter().zip(0u32..).filter(|(sum, _)| **sum != 0);
    open.map(|(_, p)| p).collect()
}

/// The closed boundary loops as points, in the direction that faces filling them run; and the trails of boundary edges
/// that do not close.
///
/// Only faces with two boundary points can have a boundary edge, so the exact search sees those only.
pub(super) fn boundary_loops(surface: &SurfaceView<'_>) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
    let sums = unmatched_neighbours(surface);
    // Each side of the faces: its edge, the smaller point first, and the side as it runs.
    let mut sides: Vec<([u32; 2], u32, usize, [u32; 2])> = Vec::new();
    for (f, t) in surface.triangles.iter().enumerate() {
        let open = |v: &&u32| {
            let sum = sums.get(surface.point_of[**v as usize] as usize);
            sum.is_some_and(|&sum| sum != 0)
        };
        if t.iter().filter(open).count() < 2 {
            continue;
        }
        if let Some(p) = surface.proper_points(f as u32) {
            sides.extend((0..3).map(|k| {
                let (a, b) = (p[k], p[(k + 1) % 3]);
                ([a.min(b), a.max(b)], f as u32, k, [a, b])
            }));
        }
    }
    sides.sort_unstable();
    let edges: Vec<[u32; 2]> = sides
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|along| along.len() == 1)
        .map(|along| along[0].3)
        .filter(|ends| ends.iter().all(|&p| sums[p as usize] != 0))
        .map(|[from, to]| [to, from])
        .collect();
    split_into_loops(&edges)
}

/// For each point the scrambled numbers of the points that follow it around its faces, less those that precede it.
fn unmatched_neighbours(surface: &SurfaceView<'_>) -> Vec<u64> {
    let mut sums = vec![0u64; surface.points as usize];
    for p in surface.proper_faces() {
        for i in 0..3 {
            let sum = &mut sums[p[i] as usize];
            *sum = sum
                .wrapping_add(scramble(p[(i + 1) % 3]))
                .wrapping_sub(scramble(p[(i + 2) % 3]));
        }
    }
    sums
}

/// Mixes the bits of a number: the finaliser of SplitMix64 (Steele, Lea and Flood 2014).
fn scramble(p: u32) -> u64 {
    let mut x = u64::from(p).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Splits directed edges into loops, which close and pass a point at most once, and the trails that are left, which end
/// somewhere else than they start. Deterministic in the order of `edges`.
pub(super) fn split_into_loops(edges: &[[u32; 2]]) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
    let mut order: Vec<u32> = (0..edges.len() as u32).collect();
    order.sort_by_key(|&e| edges[e as usize][0]);
    let start = |p: u32| order.partition_point(|&e| edges[e as usize][0] < p);
    let mut used = vec![false; edges.len()];
    let take = |p: u32, used: &mut Vec<bool>| {
        let from = start(p);
        let rest = order[from..].iter().take_while(|&&e| edges[e as usize][0] == p);
        let free = rest.copied().find(|&e| !used[e as usize])?;
        used[free as usize] = true;
        Some(edges[free as usize][1])
    };
    // Where more edges start than end, an open trail starts: those first, so that none begins in its middle.
    let mut surplus: Vec<(u32, i32)> = edges.iter().flat_map(|e| [(e[0], 1), (e[1], -1)]).collect();
    surplus.sort_unstable();
    let loose = surplus
        .chunk_by(|a, b| a.0 == b.0)
        .flat_map(|c| std::iter::repeat_n(c[0].0, c.iter().map(|s| s.1).sum::<i32>().max(0) as usize));
    let starts: Vec<u32> = loose.chain(edges.iter().map(|e| e[0])).collect();
    let (mut closed, mut open) = (Vec::new(), Vec::new());
    let mut place: BTreeMap<u32, usize> = BTreeMap::new();
    for first in starts {
        let mut trail = vec![first];
        place.insert(first, 0);
        while let Some(next) = trail.last().and_then(|&here| take(here, &mut used)) {
            if let Some(&met) = place.get(&next) {
                closed.push(trail[met..].to_vec());
                for gone in trail.drain(met + 1..) {
                    place.remove(&gone);
                }
            } else {
                place.insert(next, trail.len());
                trail.push(next);
            }
        }
        if trail.len() > 1 {
            open.push(trail);
        }
        place.clear();
    }
    (closed, open)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn the_rim_of_a_square_runs_against_its_faces() {
        let surface = SurfaceView {
            positions: &[DVec3::ZERO, DVec3::X, DVec3::ONE, DVec3::Y],
            triangles: &[[0, 1, 2], [0, 2, 3]],
            primitive_of: &[0, 0],
            point_of: &[0, 1, 2, 3],
            points: 4,
        };
        assert_eq!(boundary_loops(&surface), (vec![vec![1, 0, 3, 2]], vec![]));
        let closed = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let tetrahedron = SurfaceView {
            triangles: &closed,
            primitive_of: &[0; 4],
            ..surface
        };
        assert_eq!(boundary_loops(&tetrahedron), (vec![], vec![]));
    }

    #[test]
    fn the_rim_of_an_open_box_is_found_and_a_closed_one_has_none() {
        let triangles = [[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let surface = |count: usize| SurfaceView {
            positions: &positions,
            triangles: &triangles[..count],
            primitive_of: &[0; 4][..count],
            point_of: &[0, 1, 2, 3],
            points: 4,
        };
        assert!(boundary_points(&surface(4)).is_empty());
        assert_eq!(boundary_points(&surface(3)), [0, 2, 3]);
    }

    #[test]
    fn trails_part_where_they_meet_themselves() {
        let (closed, open) = split_into_loops(&[[0, 1], [1, 2], [2, 0], [2, 3], [3, 4], [4, 2], [8, 9], [7, 8]]);
        assert_eq!(closed.len(), 2);
        assert!(closed.iter().all(|l| l.len() == 3), "{closed:?}");
        assert_eq!(open, [vec![7, 8, 9]]);
    }
}
