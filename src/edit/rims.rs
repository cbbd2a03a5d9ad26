//! The rims of a whole surface, found without sorting its edges.

use super::Surface;
use super::local::{Local, points_of, trails};

/// The rims as loops of points, in the direction that faces filling them run; and the rims that do not close.
///
/// A first pass adds, at each point, a fingerprint of every neighbour that an edge leads to and takes away that of
/// every neighbour that an edge comes from. Where all edges have two faces nothing is left, so what is left marks the
/// few points that can lie on a rim; the exact search then sees their faces only.
pub(super) fn rims(surface: &Surface<'_>) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
    let mut trace = vec![0u64; surface.points as usize];
    for t in surface.triangles {
        let Some(p) = points_of(surface, t) else {
            continue;
        };
        for k in 0..3 {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            if let Some(x) = trace.get_mut(a as usize) {
                *x = x.wrapping_add(fingerprint(b));
            }
            if let Some(x) = trace.get_mut(b as usize) {
                *x = x.wrapping_sub(fingerprint(a));
            }
        }
    }
    let suspect = |v: &u32| {
        trace
            .get(surface.point_of[*v as usize] as usize)
            .is_some_and(|&x| x != 0)
    };
    let near = surface
        .triangles
        .iter()
        .zip(0u32..)
        .filter(|(t, _)| t.iter().filter(|v| suspect(v)).count() > 1);
    let local = Local::of(surface, near.map(|(_, f)| f).collect());
    let edges: Vec<[u32; 2]> = (local.rim().into_iter())
        .map(|side| local.ends(side))
        .filter(|ends| ends.iter().all(|&p| trace[local.points[p as usize] as usize] != 0))
        .map(|[from, to]| [local.points[to as usize], local.points[from as usize]])
        .collect();
    trails(&edges)
}

/// Mixes the bits of a number (Steele and others' SplitMix64), so that sums of few rarely agree.
fn fingerprint(p: u32) -> u64 {
    let mut x = u64::from(p).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn the_rim_of_a_square_runs_against_its_faces() {
        let surface = Surface {
            positions: &[DVec3::ZERO, DVec3::X, DVec3::ONE, DVec3::Y],
            triangles: &[[0, 1, 2], [0, 2, 3]],
            primitive_of: &[0, 0],
            point_of: &[0, 1, 2, 3],
            points: 4,
        };
        assert_eq!(rims(&surface), (vec![vec![1, 0, 3, 2]], vec![]));
        let closed = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let tetrahedron = Surface {
            triangles: &closed,
            primitive_of: &[0; 4],
            ..surface
        };
        assert_eq!(rims(&tetrahedron), (vec![], vec![]));
    }
}
