//! Deformation of space by radial basis functions (Botsch & Kobbelt 2005), for comparison with the graph (the paper's
//! figure 3): d(x) = Σ_j w_j |x − c_j|³ + p(x) with a linear p, the smoothest displacement that takes the handles where
//! they are wanted. It knows distances in space only, so what is close moves together, whatever way the surface goes.
//!
//! Centres are vertices that handles hold, chosen by distance alone: each is the one farthest from all before it. They
//! depend on the handles' regions, not on the pose, and so does the factor, which a session keeps. Of Φ only the part
//! matters in which no linear function is seen; there it is positive definite. Vertices that are held hard are put where
//! they belong afterwards, and how far the interpolant misses them is reported.

use glam::DVec3;
use pliant_deform::{
    DeformableBody, Error, FreePartPolicy, HandleSystem, PoseStats, SolveState, SolvedNodes, Transform, UNHELD,
};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_solver::CholeskyFactor;
use rayon::prelude::*;

/// Most centres. The factor takes 8 bytes for each pair of them.
const MOST_CENTRES: usize = 1500;
/// Most held vertices among which centres are chosen.
const MOST_CANDIDATES: usize = 1 << 16;
/// Centres nearer to each other than this, in solving units (half a bounding box to a whole one), are one.
const NEAREST: f64 = 1e-6;
/// An extent below this part of the largest one is none.
const FLAT: f64 = 1e-6;
/// Least pivot of the factor, relative to the mean of the matrix's diagonal.
const LEAST_PIVOT: f64 = 1e-13;
/// A soft handle of stiffness 1 weighs as much as this over the diagonal of Φ, in cubes of solving units.
const SOFTNESS: f64 = 1e-3;

/// A centre: the node and what holds it.
#[derive(Debug, Clone)]
struct RbfCentre {
    node: u32,
    /// (hold, weight), weights summing to 1.
    pulls: Vec<(u32, f64)>,
}

/// Everything about the interpolation that does not change with the pose.
#[derive(Debug, Clone, Default)]
struct RbfSpace {
    centres: Vec<RbfCentre>,
    places: Vec<DVec3>,
    linear: LinearFunctions,
    /// Householder vectors that turn the linear functions onto the first unknowns.
    mirrors: Vec<Vec<f64>>,
    /// The rows of the transformed Φ that belong to the linear functions, over all unknowns.
    coupling: Vec<f64>,
    /// Upper triangle that the linear functions have become, row-major.
    triangle: Vec<f64>,
    factor: CholeskyFactor,
}

/// The linear functions 1, a₁·(x − o), …: one axis for each dimension of the centres.
#[derive(Debug, Clone, Default)]
struct LinearFunctions {
    origin: DVec3,
    axes: Vec<DVec3>,
}

impl LinearFunctions {
    /// Axes towards the points that lie farthest out, so that they turn with the scene.
    fn of(points: &[DVec3]) -> Self {
        let origin = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
        let mut axes: Vec<DVec3> = Vec::new();
        let mut largest = 0.0f64;
        while axes.len() < 3 {
            let across = |p: &DVec3| {
                let from = *p - origin;
                axes.iter()
                    .fold(from, |v, a: &DVec3| v - *a * from.dot(a.normalize()) / a.length())
            };
            let Some(out) = farthest(points.iter().map(across)) else {
                break;
            };
            let extent = out.length();
            if !(extent > FLAT * largest && extent > NEAREST) {
                break;
            }
            largest = largest.max(extent);
            axes.push(out / (extent * extent));
        }
        Self { origin, axes }
    }

    fn values(&self, p: DVec3) -> impl Iterator<Item = f64> + '_ {
        let from = p - self.origin;
        std::iter::once(1.0).chain(self.axes.iter().map(move |a| a.dot(from)))
    }
}

/// The longest vector; of those that are equally long but for rounding the first.
fn farthest(vectors: impl Iterator<Item = DVec3>) -> Option<DVec3> {
    vectors.reduce(
        |best, v| match v.length_squared() > best.length_squared() * (1.0 + 1e-9) {
            true => v,
            false => best,
        },
    )
}

impl RbfSpace {
    /// Chooses centres and factors.
    fn new(body: &DeformableBody, handles: &HandleSystem, exec: &Exec<'_>) -> Result<Self, Error> {
        let (centres, softness) = centres(body, handles, exec)?;
        let places: Vec<DVec3> = centres.iter().map(|c| at_rest(body, c.node as usize)).collect();
        let linear = LinearFunctions::of(&places);
        let (m, r) = (places.len(), linear.axes.len() + 1);
        let mut phi: Vec<f64> = vec![0.0; m * m];
        exec.pool.install(|| {
            phi.par_chunks_exact_mut(m).enumerate().for_each(|(i, row)| {
                row.iter_mut()
                    .zip(&places)
                    .for_each(|(v, p)| *v = kernel(places[i] - *p));
                row[i] += softness[i];
            });
        });
        // Householder reflections that take the m × r matrix of linear functions to a triangle.
        let mut columns: Vec<Vec<f64>> = vec![Vec::with_capacity(m); r];
        for p in &places {
            columns.iter_mut().zip(linear.values(*p)).for_each(|(c, v)| c.push(v));
        }
        let mut mirrors = Vec::new();
        let mut triangle = vec![0.0; r * r];
        for k in 0..r.min(m) {
            let mut v = columns[k].clone();
            v[..k].fill(0.0);
            let length = dot(&v, &v).sqrt();
            v[k] += if v[k] < 0.0 { -length } else { length };
            let size = dot(&v, &v).sqrt();
            if size > 0.0 {
                v.iter_mut().for_each(|x| *x /= size);
            }
            columns.iter_mut().for_each(|c| reflect(&v, c));
            (0..r).for_each(|j| triangle[k * r + j] = columns[j][k]);
            mirror_both_sides(&v, &mut phi, exec.pool);
            mirrors.push(v);
        }
        exec.check()?;
        let coupling = phi[..r.min(m) * m].to_vec();
        let size = m.saturating_sub(r);
        let mut inner = Vec::with_capacity(size * size);
        phi.chunks_exact(m)
            .skip(r)
            .for_each(|row| inner.extend_from_slice(&row[r..]));
        drop(phi);
        let mean = (0..size).map(|i| inner[i * size + i]).sum::<f64>() / size.max(1) as f64;
        let factor = CholeskyFactor::new(inner, size, LEAST_PIVOT * mean.abs().max(1e-300), exec)?;
        Ok(Self {
            centres,
            places,
            linear,
            mirrors,
            coupling,
            triangle,
            factor,
        })
    }

    /// The displacement that takes every centre by `wanted`.
    fn interpolate(&self, wanted: &[DVec3]) -> RbfDisplacement<'_> {
        let (m, r) = (self.places.len(), self.linear.axes.len() + 1);
        let head = r.min(m);
        let mut y: Vec<[f64; 3]> = wanted.iter().map(DVec3::to_array).collect();
        self.mirrors.iter().for_each(|v| reflect_rows(v, &mut y));
        let (low, high) = y.split_at_mut(head);
        self.factor.solve(high);
        // What the basis functions do to the linear part's rows is taken off, then the triangle is solved.
        let mut linear = vec![[0.0; 3]; r];
        for k in (0..head).rev() {
            let mut v = low[k];
            for (a, x) in self.coupling[k * m + head..(k + 1) * m].iter().zip(&*high) {
                (0..3).for_each(|c| v[c] -= a * x[c]);
            }
            for j in k + 1..r {
                (0..3).for_each(|c| v[c] -= self.triangle[k * r + j] * linear[j][c]);
            }
            linear[k] = v.map(|v| v / self.triangle[k * r + k]);
        }
        low.fill([0.0; 3]);
        self.mirrors.iter().rev().for_each(|v| reflect_rows(v, &mut y));
        RbfDisplacement {
            space: self,
            weights: y,
            linear,
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.factor.byte_size()
            + (self.mirrors.len() + self.coupling.len() / self.places.len().max(1) + 9) * self.places.len() * 8
    }
}

/// A displacement of space, in solving coordinates.
struct RbfDisplacement<'a> {
    space: &'a RbfSpace,
    weights: Vec<[f64; 3]>,
    linear: Vec<[f64; 3]>,
}

/// Points that are displaced side by side, so that no sum waits for another.
const BUNDLE: usize = 4;

impl RbfDisplacement<'_> {
    fn at(&self, points: &[DVec3; BUNDLE]) -> [DVec3; BUNDLE] {
        let [x, y, z] = [0, 1, 2].map(|axis| points.map(|p| p[axis]));
        let mut sums = [[0.0; BUNDLE]; 3];
        for (centre, w) in self.space.places.iter().zip(&self.weights) {
            for l in 0..BUNDLE {
                let (dx, dy, dz) = (x[l] - centre.x, y[l] - centre.y, z[l] - centre.z);
                let square = dx * dx + dy * dy + dz * dz;
                let value = square * square.sqrt();
                for c in 0..3 {
                    sums[c][l] += value * w[c];
                }
            }
        }
        std::array::from_fn(|l| {
            let mut sum = sums.map(|s| s[l]);
            for (value, a) in self.space.linear.values(points[l]).zip(&self.linear) {
                (0..3).for_each(|c| sum[c] += value * a[c]);
            }
            DVec3::from_array(sum)
        })
    }
}

fn at_rest(body: &DeformableBody, node: usize) -> DVec3 {
    body.rest(node)
}

fn kernel(d: DVec3) -> f64 {
    let square = d.length_squared();
    square * square.sqrt()
}

/// The centres, and by centre what softness adds to the diagonal.
fn centres(
    body: &DeformableBody,
    handles: &HandleSystem,
    exec: &Exec<'_>,
) -> Result<(Vec<RbfCentre>, Vec<f64>), Error> {
    let owners = handles.position_owners();
    let mut candidates: Vec<u32> = (0u32..)
        .zip(&owners.hard[..body.graph.surface])
        .filter(|(_, k)| **k != UNHELD)
        .map(|(i, _)| i)
        .collect();
    let soft = owners
        .soft
        .iter()
        .map(|s| s.0)
        .filter(|&i| (i as usize) < body.graph.surface);
    candidates.extend(soft);
    candidates.sort_unstable();
    candidates.dedup();
    if candidates.is_empty() {
        return Err(Error::NoPosition);
    }
    let stride = candidates.len().div_ceil(MOST_CANDIDATES).max(1);
    let candidates: Vec<u32> = candidates.into_iter().step_by(stride).collect();
    let places: Vec<DVec3> = candidates.iter().map(|&i| at_rest(body, i as usize)).collect();
    let mut chosen = Vec::new();
    let mut distance = vec![f64::INFINITY; places.len()];
    let mut next = (!places.is_empty()).then_some(0);
    while let Some(k) = next.filter(|_| chosen.len() < MOST_CENTRES) {
        if chosen.len() % 64 == 0 {
            exec.check()?;
        }
        chosen.push(k);
        exec.pool.install(|| {
            distance
                .par_iter_mut()
                .zip(&places)
                .with_min_len(4096)
                .for_each(|(d, p)| *d = d.min(p.distance_squared(places[k])));
        });
        let farthest = distance.iter().enumerate().fold((0, 0.0), |best, (i, &d)| {
            // Equal but for rounding: the first, so that turning the scene changes nothing.
            if d > best.1 * (1.0 + 1e-9) { (i, d) } else { best }
        });
        next = (farthest.1 > NEAREST * NEAREST).then_some(farthest.0);
    }
    chosen.sort_unstable();
    let pulls_of = |node: u32| {
        let from = owners.soft.partition_point(|s| s.0 < node);
        owners.soft[from..].iter().take_while(move |s| s.0 == node)
    };
    let centres = chosen.into_iter().map(|k| {
        let node = candidates[k];
        match owners.hard[node as usize] {
            UNHELD => {
                let whole: f64 = pulls_of(node).map(|s| s.2).sum();
                let pulls = pulls_of(node).map(|s| (s.1, s.2 / whole)).collect();
                (RbfCentre { node, pulls }, SOFTNESS / whole.max(1e-12))
            }
            k => {
                let pulls = vec![(k, 1.0)];
                (RbfCentre { node, pulls }, 0.0)
            }
        }
    });
    Ok(centres.unzip())
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// x − 2 v (v·x).
fn reflect(v: &[f64], x: &mut [f64]) {
    let twice = 2.0 * dot(v, x);
    x.iter_mut().zip(v).for_each(|(x, v)| *x -= twice * v);
}

fn reflect_rows(v: &[f64], x: &mut [[f64; 3]]) {
    for c in 0..3 {
        let twice = 2.0 * x.iter().zip(v).map(|(x, v)| x[c] * v).sum::<f64>();
        x.iter_mut().zip(v).for_each(|(x, v)| x[c] -= twice * v);
    }
}

/// (I − 2 v vᵀ) A (I − 2 v vᵀ) of a symmetric matrix.
fn mirror_both_sides(v: &[f64], a: &mut [f64], pool: &Pool) {
    let m = v.len();
    pool.install(|| {
        let mut q: Vec<f64> = a.par_chunks_exact(m).map(|row| dot(row, v)).collect();
        let along = dot(&q, v);
        q.iter_mut().zip(v).for_each(|(q, v)| *q -= along * v);
        a.par_chunks_exact_mut(m).enumerate().for_each(|(i, row)| {
            for (j, x) in row.iter_mut().enumerate() {
                *x -= 2.0 * (v[i] * q[j] + q[i] * v[j]);
            }
        });
    });
}

/// Solves poses by deforming space, with what it has made of the handles once.
#[derive(Debug, Default)]
pub struct SpatialRbf {
    space: Option<Box<RbfSpace>>,
}

impl SpatialRbf {
    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.space.as_ref().map_or(0, |space| space.byte_size())
    }

    /// Solves a pose by deforming space instead of the graph. Of loose parts only those stay that the policy
    /// [`FreePartPolicy::Hold`] keeps: all others are where space takes them. The result reports how far the interpolant misses
    /// held vertices, which are then put where they belong. `state` forgets the last solution on the graph.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`].
    pub fn solve(
        &mut self,
        handles: &HandleSystem,
        body: &DeformableBody,
        transforms: &[Transform],
        state: &mut SolveState,
        exec: &Exec<'_>,
    ) -> Result<SolvedNodes, Error> {
        if transforms.iter().all(Transform::is_identity) {
            return Ok(SolvedNodes::at_rest(body));
        }
        // The graph's solves start afresh after this one.
        state.forget();
        let space = match self.space.take() {
            Some(space) => space,
            None => Box::new(RbfSpace::new(body, handles, exec)?),
        };
        let space: &RbfSpace = self.space.insert(space);
        let maps: Vec<_> = transforms.iter().map(Transform::map).collect();
        let wanted = |node: usize, hold: u32| match maps.get(hold as usize) {
            Some(map) => body.solving_from_model(map(body.graph.positions[node])) - at_rest(body, node),
            None => DVec3::ZERO,
        };
        let targets: Vec<DVec3> = space
            .centres
            .iter()
            .map(|c| c.pulls.iter().map(|&(k, u)| wanted(c.node as usize, k) * u).sum())
            .collect();
        let displacement = space.interpolate(&targets);
        let mut moves: Vec<DVec3> = Vec::with_capacity(body.nodes());
        // In pieces, so that a cancelled solve ends soon.
        for from in (0..body.nodes()).step_by(1 << 14) {
            exec.check()?;
            let to = body.nodes().min(from + (1 << 14));
            let piece: Vec<[DVec3; BUNDLE]> = exec.pool.install(|| {
                (from..to)
                    .into_par_iter()
                    .step_by(BUNDLE)
                    .with_min_len(16)
                    .map(|i| displacement.at(&std::array::from_fn(|l| at_rest(body, (i + l).min(to - 1)))))
                    .collect()
            });
            moves.extend(piece.into_flattened().into_iter().take(to - from));
        }
        let (mut missed, mut farthest) = (0.0f64, 0.0f64);
        let owners = handles.position_owners();
        for i in (0..body.graph.surface).filter(|&i| owners.hard[i] != UNHELD) {
            let wanted = wanted(i, owners.hard[i]);
            missed = missed.max(wanted.distance(moves[i]));
            farthest = farthest.max(wanted.length());
        }
        let mut x: Vec<f64> = moves
            .iter()
            .enumerate()
            .flat_map(|(i, d)| (at_rest(body, i) + *d).to_array())
            .collect();
        handles.make_regions_rigid(body, transforms, &mut [], &mut x);
        let stays =
            |i: usize| handles.setup().policy == FreePartPolicy::Hold && handles.given()[i] && owners.hard[i] == UNHELD;
        let positions: Vec<DVec3> = (0..body.nodes())
            .map(|i| match owners.hard[i] {
                UNHELD if stays(i) => body.graph.positions[i],
                UNHELD => body.model_from_solving(DVec3::from_slice(&x[3 * i..3 * i + 3])),
                k => maps
                    .get(k as usize)
                    .map_or(body.graph.positions[i], |map| map(body.graph.positions[i])),
            })
            .collect();
        if let Some(node) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Solver(format!("node {node} left the range of numbers")));
        }
        Ok(SolvedNodes {
            positions,
            frames: Vec::new(),
            stats: PoseStats {
                cycles: 1,
                refined: 0,
                residual: missed / farthest.max(f64::MIN_POSITIVE),
                max_error: missed * body.unit() / body.diagonal,
                solver: "spatial-rbf",
            },
        })
    }
}
