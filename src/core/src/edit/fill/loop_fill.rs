//! Filling a hole whose rim is any loop in space (Liepa, "Filling Holes in Meshes", 2003): triangulate, refine, fair.
//!
//! Up to two hundred edges the triangulation is the one with the smallest bend, then the smallest area, found by
//! dynamic programming over the intervals of the loop; above, the loop is laid into its mean plane.

use super::fair::fair_points;
use super::opening::{OpeningRim, split_double_edges};
use super::polygon::triangulate_polygon;
use super::refine::{RefineSize, make_edges_delaunay, refine_faces};
use crate::edit::error::Error;
use crate::edit::region_mesh::{CAP, RegionMesh};
use crate::progress::{Progress, check};
use glam::{DVec2, DVec3};

/// Loops with more edges are laid into a plane: the exact search takes their number to the third power.
const EXACT: usize = 200;

/// The longest loop that is filled.
const LONGEST: usize = 20_000;

/// Fills the hole inside `ring`, given in the direction that the new faces run along it: against the faces around.
pub(super) fn fill_loop(mesh: &mut RegionMesh, ring: &[u32], progress: &dyn Progress) -> Result<(), Error> {
    let loops = [ring.to_vec()];
    let rim = OpeningRim::from_loops(mesh, &loops, &[]);
    let first = mesh.faces.len();
    match triangulate_loop(mesh, ring, true, progress)? {
        Some(triangles) => triangles
            .into_iter()
            .for_each(|t| rim.add_face(mesh, t.map(|i| ring[i as usize]))),
        None => rim.fill_with_fan(mesh, ring),
    }
    split_double_edges(mesh, first);
    let mut inner = refine_faces(mesh, first, &rim.sizes, RefineSize::for_loop(ring.len()), progress)?;
    let on_rim = |p: &u32| rim.sizes.contains_key(p);
    inner.extend(
        mesh.faces[first..]
            .iter()
            .filter(|f| f.alive)
            .flat_map(|f| f.points)
            .filter(|p| !on_rim(p)),
    );
    inner.sort_unstable();
    inner.dedup();
    fair_points(mesh, &inner, ring, progress)?;
    make_edges_delaunay(mesh, first, progress)
}

/// Triangles over places in a loop, with no new point; `None` when there are none that use only edges that are free.
/// With `onward` the bend against the faces around counts as well.
pub(in crate::edit) fn triangulate_loop(
    mesh: &RegionMesh,
    ring: &[u32],
    onward: bool,
    progress: &dyn Progress,
) -> Result<Option<Vec<[u32; 3]>>, Error> {
    if ring.len() > LONGEST {
        return Err(Error::TooLarge {
            what: "edges around one hole",
            seen: ring.len() as u64,
            limit: LONGEST as u64,
        });
    }
    check(progress)?;
    if ring.len() <= EXACT {
        Ok(triangulate_with_least_bend(mesh, ring, onward))
    } else {
        triangulate_in_mean_plane(mesh, ring, progress)
    }
}

/// What a triangulation of a part of the loop costs: its sharpest bend in steps, then its area.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
struct BendCost(u32, f64);

/// Bends are compared in steps, so that rounding does not decide between triangulations of a flat hole.
const STEPS: f64 = 1e4;

fn bend_steps(one: DVec3, two: DVec3) -> u32 {
    ((1.0 - one.dot(two)).clamp(0.0, 2.0) * STEPS) as u32
}

/// The triangulation with the smallest largest bend, over places in the loop. `None` when every one would need an edge
/// that the surface has already.
fn triangulate_with_least_bend(mesh: &RegionMesh, ring: &[u32], onward: bool) -> Option<Vec<[u32; 3]>> {
    let n = ring.len();
    if n < 3 {
        return None;
    }
    let at: Vec<DVec3> = ring.iter().map(|&p| mesh.position(p)).collect();
    let unit = |i: usize, j: usize, k: usize| (at[j] - at[i]).cross(at[k] - at[i]).normalize_or_zero();
    // The normal beside each edge of the loop, i to i + 1.
    let beside = |i: usize| {
        let face = mesh
            .faces_along(ring[i], ring[(i + 1) % n])
            .find(|&f| mesh.faces[f as usize].source != CAP);
        face.filter(|_| onward).map(|f| mesh.area_normal(f).normalize_or_zero())
    };
    let joined: Vec<Vec<bool>> = (0..n)
        .map(|i| {
            (0..n)
                .map(|k| i.abs_diff(k) > 1 && i.abs_diff(k) < n - 1 && mesh.has_edge(ring[i], ring[k]))
                .collect()
        })
        .collect();
    let twin = n == 3
        && (mesh.faces_around(ring[0]).iter())
            .any(|&f| ring.iter().all(|&p| mesh.faces[f as usize].corner_of(p).is_some()));
    if twin {
        return None;
    }
    let slot = |i: usize, k: usize| i * n + k;
    let mut cost: Vec<Option<BendCost>> = vec![None; n * n];
    let mut normal: Vec<Option<DVec3>> = vec![None; n * n];
    let mut middle: Vec<usize> = vec![0; n * n];
    for i in 0..n - 1 {
        cost[slot(i, i + 1)] = Some(BendCost(0, 0.0));
        normal[slot(i, i + 1)] = beside(i);
    }
    let last = beside(n - 1);
    for width in 2..n {
        for i in 0..n - width {
            let k = i + width;
            if joined[i][k] {
                continue;
            }
            let mut best: Option<(BendCost, DVec3, usize)> = None;
            for m in i + 1..k {
                let (Some(one), Some(two)) = (cost[slot(i, m)], cost[slot(m, k)]) else {
                    continue;
                };
                let sharpest = one.0.max(two.0);
                if best.is_some_and(|b| sharpest > b.0.0) {
                    continue;
                }
                let own = unit(i, m, k);
                let area = (at[m] - at[i]).cross(at[k] - at[i]).length();
                let mut sharpest = sharpest;
                for other in [normal[slot(i, m)], normal[slot(m, k)]].into_iter().flatten() {
                    sharpest = sharpest.max(bend_steps(own, other));
                }
                if let Some(other) = last.filter(|_| width == n - 1) {
                    sharpest = sharpest.max(bend_steps(own, other));
                }
                let all = BendCost(sharpest, one.1 + two.1 + area);
                if best.is_none_or(|b| all < b.0) {
                    best = Some((all, own, m));
                }
            }
            if let Some((all, own, m)) = best {
                cost[slot(i, k)] = Some(all);
                normal[slot(i, k)] = Some(own);
                middle[slot(i, k)] = m;
            }
        }
    }
    cost[slot(0, n - 1)]?;
    let mut triangles = Vec::with_capacity(n - 2);
    let mut open = vec![(0, n - 1)];
    while let Some((i, k)) = open.pop() {
        if k - i < 2 {
            continue;
        }
        let m = middle[slot(i, k)];
        triangles.push([i as u32, m as u32, k as u32]);
        open.extend([(i, m), (m, k)]);
    }
    Some(triangles)
}

/// Lays the loop into the plane of its vector area and triangulates it there, over places in the loop.
fn triangulate_in_mean_plane(
    mesh: &RegionMesh,
    ring: &[u32],
    progress: &dyn Progress,
) -> Result<Option<Vec<[u32; 3]>>, Error> {
    let origin = mesh.position(ring[0]);
    let at: Vec<DVec3> = ring.iter().map(|&p| mesh.position(p) - origin).collect();
    let sum: DVec3 = (0..at.len()).map(|i| at[i].cross(at[(i + 1) % at.len()])).sum();
    let Some(normal) = sum.try_normalize() else {
        return Ok(None);
    };
    let right = normal.any_orthonormal_vector();
    let up = normal.cross(right);
    let flat: Vec<DVec2> = at.iter().map(|x| DVec2::new(x.dot(right), x.dot(up))).collect();
    let all: Vec<u32> = (0..ring.len() as u32).collect();
    Ok(triangulate_polygon(&flat, &all, &[], progress)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::surface::SurfaceView;
    use crate::progress::Silent;

    /// An open box without its top: a ring of points, more on the long sides, and walls below.
    #[test]
    fn the_least_bend_spans_a_box_flat() {
        let top: Vec<DVec3> = (0..12u32)
            .map(|k| {
                let (side, along) = (k / 3, f64::from(k % 3));
                let p = [[along, 0.0], [3.0, along], [3.0 - along, 3.0], [0.0, 3.0 - along]][side as usize];
                DVec3::new(p[0], p[1], 0.0)
            })
            .collect();
        let mut positions = top.clone();
        positions.extend(top.iter().map(|p| *p - DVec3::Z));
        let triangles: Vec<[u32; 3]> = (0..12u32)
            .flat_map(|k| {
                let next = (k + 1) % 12;
                [[k, k + 12, next + 12], [k, next + 12, next]]
            })
            .collect();
        let points: Vec<u32> = (0..24).collect();
        let surface = SurfaceView {
            positions: &positions,
            triangles: &triangles,
            primitive_of: &[0; 24],
            point_of: &points,
            points: 24,
        };
        let mut mesh = RegionMesh::with_ring(&surface, &(0..24).collect::<Vec<u32>>());
        let ring: Vec<u32> = (0..12).collect();
        for onward in [false, true] {
            let found = triangulate_loop(&mesh, &ring, onward, &Silent)
                .expect("not cancelled")
                .expect("free edges");
            let normals = found.iter().map(|t| {
                let [a, b, c] = t.map(|i| positions[i as usize]);
                (b - a).cross(c - a)
            });
            assert_eq!(found.len(), 10);
            assert!(normals.clone().all(|n| n.z >= 0.0));
            assert!((normals.map(|n| n.z).sum::<f64>() - 18.0).abs() < 1e-12);
        }
        fill_loop(&mut mesh, &ring, &Silent).expect("fills");
        assert_eq!(mesh.open_sides(|a, b| a < 12 && b < 12), []);
    }
}
