//! Filling a hole whose rim is any loop in space (Liepa, "Filling Holes in Meshes", 2003): triangulate, refine, fair.
//!
//! Up to two hundred edges the triangulation is the one with the smallest bend, then the smallest area, found by
//! dynamic programming over the intervals of the loop; above, the loop is laid into its mean plane.
//!
//! Fairing: new points laid so that the surface bends as little as it can, running on from what is around.
//!
//! Minimises the sum of squared umbrellas (mean of the neighbours minus the point) over the new points and the rim,
//! the discrete thin plate of Kobbelt and others ("Interactive Multi-Resolution Modeling on Arbitrary Meshes", 1998),
//! by conjugate gradients. The rim and all beyond stay.
//!
//! Triangles of a new patch of surface made as large as those around it (Liepa, "Filling Holes in Meshes", 2003,
//! section 3): a triangle that is too large for its corners gets a point in its middle, then edges are exchanged until
//! opposite angles are no more than half a turn together.

use super::opening::{CapLook, OpeningRim, split_double_edges};
use super::polygon::triangulate_polygon;
use crate::region_mesh::{CAP, RegionMesh, edge_key};
use glam::{DVec2, DVec3};
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, sorted_set};
use std::collections::BTreeMap;

/// Loops with more edges are laid into a plane: the exact search takes their number to the third power.
const EXACT: usize = 200;

/// The longest loop that is filled.
const LONGEST: usize = 20_000;

/// Fills the hole inside `ring`, given in the direction that the new faces run along it: against the faces around.
pub(crate) fn fill_loop(
    mesh: &mut RegionMesh,
    ring: &[u32],
    look: CapLook<'_>,
    progress: &dyn Progress,
) -> Result<(), Error> {
    let loops = [ring.to_vec()];
    let rim = OpeningRim::from_loops(mesh, &loops, look);
    let first = mesh.faces.len();
    match triangulate_loop(mesh, ring, true, progress)? {
        Some(triangles) => triangles
            .into_iter()
            .for_each(|t| rim.add_face(mesh, t.map(|i| ring[i as usize]))),
        None => rim.fill_with_fan(mesh, ring),
    }
    split_double_edges(mesh, first);
    let mut inner = refine_faces(mesh, first, &rim.sizes, RefineSize::for_loop(ring.len()), progress)?;
    inner.extend(inner_points(mesh, first, &rim.sizes));
    inner.sort_unstable();
    inner.dedup();
    fair_points(mesh, &inner, ring, progress)?;
    make_edges_delaunay(mesh, first, progress)
}

/// Triangles over places in a loop, with no new point; `None` when there are none that use only edges that are free.
/// With `onward` the bend against the faces around counts as well.
pub(crate) fn triangulate_loop(
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
const COSINE_STEPS: f64 = 1e4;

fn bend_steps(one: DVec3, two: DVec3) -> u32 {
    ((1.0 - one.dot(two)).clamp(0.0, 2.0) * COSINE_STEPS) as u32
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

/// Steps of conjugate gradients at most; holes of a few thousand points need fewer.
const FAIRING_STEPS: usize = 400;

/// The residual, relative to the first, at which the shape is good: well below a thousandth of an edge.
const ENOUGH: f64 = 1e-4;

/// One umbrella: the mean of the neighbours' places minus the place of the row's own point, split into what may move
/// and what stays.
struct UmbrellaRows {
    /// Number of the row's own point among the inner ones.
    own: Vec<Option<u32>>,
    offsets: Vec<usize>,
    /// Inner neighbours.
    inner: Vec<u32>,
    /// One over the number of neighbours.
    share: Vec<f64>,
    /// What the fixed places add.
    fixed: Vec<DVec3>,
}

impl UmbrellaRows {
    fn gather(mesh: &RegionMesh, inner: &[u32], rim: &[u32]) -> Self {
        let number = |p: u32| inner.binary_search(&p).ok().map(|i| i as u32);
        let mut rows = Self {
            own: Vec::new(),
            offsets: vec![0],
            inner: Vec::new(),
            share: Vec::new(),
            fixed: Vec::new(),
        };
        for &p in inner.iter().chain(rim) {
            let beside = mesh.neighbours(p);
            let share = 1.0 / beside.len().max(1) as f64;
            let mut fixed = DVec3::ZERO;
            for q in beside {
                match number(q) {
                    Some(i) => rows.inner.push(i),
                    None => fixed += mesh.position(q) * share,
                }
            }
            rows.own.push(number(p));
            if number(p).is_none() {
                fixed -= mesh.position(p);
            }
            rows.offsets.push(rows.inner.len());
            rows.share.push(share);
            rows.fixed.push(fixed);
        }
        rows
    }

    /// Computes the umbrellas of `x`, without what is fixed.
    fn apply_umbrellas(&self, x: &[DVec3], out: &mut [DVec3]) {
        for (r, u) in out.iter_mut().enumerate() {
            let sum: DVec3 = self.inner[self.offsets[r]..self.offsets[r + 1]]
                .iter()
                .map(|&i| x[i as usize])
                .sum();
            *u = sum * self.share[r] - self.own[r].map_or(DVec3::ZERO, |i| x[i as usize]);
        }
    }

    /// Applies the transposed map.
    fn apply_transposed(&self, u: &[DVec3], out: &mut [DVec3]) {
        out.fill(DVec3::ZERO);
        for (r, &u) in u.iter().enumerate() {
            for &i in &self.inner[self.offsets[r]..self.offsets[r + 1]] {
                out[i as usize] += u * self.share[r];
            }
            if let Some(i) = self.own[r] {
                out[i as usize] -= u;
            }
        }
    }
}

/// Moves the points `inner` (rising) of a new patch inside `ring` so that the patch bends as little as it can.
fn fair_points(mesh: &mut RegionMesh, inner: &[u32], ring: &[u32], progress: &dyn Progress) -> Result<(), Error> {
    if inner.is_empty() {
        return Ok(());
    }
    let rows = UmbrellaRows::gather(mesh, inner, ring);
    let mut x: Vec<DVec3> = inner.iter().map(|&p| mesh.position(p)).collect();
    let mut u = vec![DVec3::ZERO; rows.own.len()];
    let mut residual = vec![DVec3::ZERO; x.len()];
    rows.apply_umbrellas(&x, &mut u);
    u.iter_mut().zip(&rows.fixed).for_each(|(u, f)| *u += *f);
    rows.apply_transposed(&u, &mut residual);
    residual.iter_mut().for_each(|r| *r = -*r);
    let mut direction = residual.clone();
    let mut across = vec![DVec3::ZERO; x.len()];
    let square = |v: &[DVec3]| v.iter().map(|v| v.length_squared()).sum::<f64>();
    let first = square(&residual);
    let mut now = first;
    for step in 0..FAIRING_STEPS {
        if now <= first * ENOUGH * ENOUGH || !now.is_finite() {
            break;
        }
        if step % 16 == 0 && progress.cancelled() {
            return Err(Error::Cancelled);
        }
        rows.apply_umbrellas(&direction, &mut u);
        let bend = square(&u);
        if bend <= 0.0 || !bend.is_finite() {
            break;
        }
        rows.apply_transposed(&u, &mut across);
        let length = now / bend;
        for i in 0..x.len() {
            x[i] += direction[i] * length;
            residual[i] -= across[i] * length;
        }
        let next = square(&residual);
        let turn = next / now;
        now = next;
        for i in 0..x.len() {
            direction[i] = residual[i] + direction[i] * turn;
        }
    }
    // A rim that is itself crumpled can throw the plate far out; then the flat filling is the better one.
    let (low, high) = ring
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| {
            let at = mesh.position(p);
            (low.min(at), high.max(at))
        });
    let reach = 0.75 * (high - low).length();
    let middle = (low + high) * 0.5;
    if x.iter().all(|x| x.distance(middle) <= reach) {
        for (&p, &x) in inner.iter().zip(&x) {
            mesh.points[p as usize].position = x;
        }
    }
    Ok(())
}

/// How far to refine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RefineSize {
    /// How much larger triangles may become with each point on the way inside.
    pub growth: f64,
    /// At most this many points.
    pub most: usize,
}

impl RefineSize {
    /// Chooses for an opening with so many edges around it: even triangles in small ones, growing ones in large ones, whose
    /// number of points would else grow with the square of their rim.
    pub fn for_loop(edges: usize) -> Self {
        Self {
            growth: if edges <= 400 { 1.0 } else { 2.0 },
            most: 40 * edges + 100,
        }
    }
}

/// Edges along a cut are pieces of faces; those of the surface are about so many times longer.
pub(crate) const WHOLE_EDGES: f64 = 2.0;

/// Rounds of splitting; each halves the triangles at least, so this many reach any size that numbers can have.
const ROUNDS: usize = 60;

/// Refines the new faces of `mesh` from number `first` on. `sizes` says how long edges are at the points of the rim.
/// Answers the new points.
pub(crate) fn refine_faces(
    mesh: &mut RegionMesh,
    first: usize,
    sizes: &BTreeMap<u32, f64>,
    size: RefineSize,
    progress: &dyn Progress,
) -> Result<Vec<u32>, Error> {
    let mut target: Vec<f64> = vec![0.0; mesh.points.len()];
    for (&p, &s) in sizes {
        target[p as usize] = s;
    }
    // Points that are there already (the middle of a fan) take the mean of what is around them.
    let inner: Vec<u32> = inner_points(mesh, first, sizes);
    let mean = sizes.values().sum::<f64>() / sizes.len().max(1) as f64;
    inner.iter().for_each(|&p| target[p as usize] = mean);
    let mut made = inner;
    make_edges_delaunay(mesh, first, progress)?;
    for _ in 0..ROUNDS {
        let (before, fresh) = (made.len(), mesh.faces.len());
        for f in first..fresh {
            let face = mesh.faces[f];
            if !face.alive || face.source != CAP || made.len() >= size.most {
                continue;
            }
            let corners = face.points.map(|p| mesh.position(p));
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            let wanted = face.points.map(|p| target[p as usize]);
            let own = (wanted[0] + wanted[1] + wanted[2]) / 3.0;
            let large = |k: usize| {
                let reach = std::f64::consts::SQRT_2 * middle.distance(corners[k]);
                reach > own && reach > wanted[k]
            };
            if (0..3).all(large) {
                made.push(mesh.split_face(f as u32, [1.0 / 3.0; 3], middle));
                target.push(own * size.growth);
            }
        }
        if made.len() == before {
            break;
        }
        // What was not split and not exchanged is as it should be.
        make_edges_delaunay(mesh, fresh, progress)?;
    }
    Ok(made)
}

/// Points of the new faces that are not on the rim.
fn inner_points(mesh: &RegionMesh, first: usize, sizes: &BTreeMap<u32, f64>) -> Vec<u32> {
    let faces = mesh.faces[first..].iter().filter(|f| f.alive);
    sorted_set(faces.flat_map(|f| f.points).filter(|p| !sizes.contains_key(p)))
}

/// Exchanges inner edges of the faces from `first` on whose opposite angles are more than half a turn together.
fn make_edges_delaunay(mesh: &mut RegionMesh, first: usize, progress: &dyn Progress) -> Result<(), Error> {
    let mut queue = mesh.edges_from(first, |_| true);
    // In a plane the exchanges end by themselves; on a bent patch they might go round.
    let mut budget = 16 * queue.len() + 1024;
    while let Some((a, b)) = queue.pop() {
        let Some(pair) = mesh.flippable_pair(a, b) else {
            continue;
        };
        let [p, q] = [pair[0].1, pair[1].1];
        let at = |p: u32| mesh.position(p);
        // The sum of two angles is above half a turn when the sum of their cotangents is negative.
        let cotangent = |apex: u32| {
            let (u, v) = (at(a) - at(apex), at(b) - at(apex));
            u.dot(v) / u.cross(v).length().max(f64::MIN_POSITIVE)
        };
        let score = cotangent(p) + cotangent(q);
        if score >= -1e-9 || score.is_nan() {
            continue;
        }
        if !mesh.flip_keeps_sides(a, b, pair) {
            continue;
        }
        mesh.flip_edge(a, b, pair);
        budget = budget.saturating_sub(1);
        if budget == 0 {
            break;
        }
        if budget.is_multiple_of(256) {
            check(progress)?;
        }
        queue.extend([edge_key(a, q), edge_key(q, b), edge_key(b, p), edge_key(p, a)]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::TestSurface;
    use pliant_exec::progress::Silent;

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
        let open = TestSurface::new(positions, triangles);
        let mut mesh = RegionMesh::with_ring(&open.view(), &(0..24).collect::<Vec<u32>>());
        let ring: Vec<u32> = (0..12).collect();
        for onward in [false, true] {
            let found = triangulate_loop(&mesh, &ring, onward, &Silent)
                .expect("not cancelled")
                .expect("free edges");
            let normals = found.iter().map(|t| {
                let [a, b, c] = t.map(|i| open.positions[i as usize]);
                (b - a).cross(c - a)
            });
            assert_eq!(found.len(), 10);
            assert!(normals.clone().all(|n| n.z >= 0.0));
            assert!((normals.map(|n| n.z).sum::<f64>() - 18.0).abs() < 1e-12);
        }
        fill_loop(&mut mesh, &ring, CapLook::default(), &Silent).expect("fills");
        assert_eq!(mesh.open_sides(|a, b| a < 12 && b < 12), []);
    }
}
