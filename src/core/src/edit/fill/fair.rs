//! Fairing: new points laid so that the surface bends as little as it can, running on from what is around.
//!
//! Minimises the sum of squared umbrellas (mean of the neighbours minus the point) over the new points and the rim,
//! the discrete thin plate of Kobbelt and others ("Interactive Multi-Resolution Modeling on Arbitrary Meshes", 1998),
//! by conjugate gradients. The rim and all beyond stay.

use crate::edit::error::Error;
use crate::edit::region_mesh::RegionMesh;
use crate::progress::Progress;
use glam::DVec3;

/// Steps of conjugate gradients at most; holes of a few thousand points need fewer.
const STEPS: usize = 400;

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
            let mut beside: Vec<u32> = (mesh.faces_around(p).iter())
                .flat_map(|&f| mesh.faces[f as usize].points)
                .filter(|&q| q != p)
                .collect();
            beside.sort_unstable();
            beside.dedup();
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
pub(super) fn fair_points(
    mesh: &mut RegionMesh,
    inner: &[u32],
    ring: &[u32],
    progress: &dyn Progress,
) -> Result<(), Error> {
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
    for step in 0..STEPS {
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
