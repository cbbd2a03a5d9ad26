//! Points with the neighbourhoods that they follow, and the carrier of one deformed shape.
//!
//! Which samples of a surface a point follows, and how much.

use crate::carry::motion::{CarriedFrame, SurfaceMotion};
use crate::carry::motion::{CarrySurface, NearestPlace};
use crate::carry::stretch::{CarriedSpace, SurfaceStretch};
use crate::measure::BoundingBox;
use crate::query::closest_point::{blend_corners, closest_weights_on_triangle};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Cancelled;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::Arc;

/// Points that one piece of parallel work takes.
const BATCH: usize = 64;

/// Points of rest space with what they follow, found once and carried into many shapes: a shape then costs one short sum
/// for each point.
#[derive(Debug, Clone, Default)]
pub struct CarriedPoints {
    points: Vec<DVec3>,
    /// From the mean place of what a point follows to the point.
    levers: Vec<DVec3>,
    /// Where the samples of each point begin; one more than there are points.
    first: Vec<usize>,
    samples: Vec<u32>,
    weights: Vec<f64>,
}

impl CarriedPoints {
    /// Finds what each of `points` follows on `surface`, in about `log n` time each; where triangles are as long as the surface it
    /// may look at each of them, and each point may follow all.
    ///
    /// # Errors
    /// [`Cancelled`], one point after the work was given up.
    pub fn bind(surface: &CarrySurface, points: &[DVec3], exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let mut all = Self::default();
        all.bind_more(surface, points, exec)?;
        Ok(all)
    }

    /// Adds points, as [`CarriedPoints::bind`] finds what they follow. Answers how many parts of the surface it looked at.
    ///
    /// # Errors
    /// As there; nothing is added then.
    pub fn bind_more(&mut self, surface: &CarrySurface, points: &[DVec3], exec: &Exec<'_>) -> Result<u64, Cancelled> {
        // Points that are near each other look at the same parts of the surface, and find them in a cache.
        let order = order_by_place(points);
        let batches: Vec<(Self, u64)> = exec.pool.install(|| {
            let batches = order.par_chunks(BATCH);
            batches
                .map(|batch| Self::bind_batch(surface, points, batch, exec))
                .collect::<Result<_, _>>()
        })?;
        let mut place_in = vec![0u32; points.len()];
        order
            .iter()
            .zip(0..)
            .for_each(|(&point, place)| place_in[point as usize] = place);
        if self.first.is_empty() {
            self.first.push(0);
        }
        self.points.extend_from_slice(points);
        for place in place_in.iter().map(|&place| place as usize) {
            let (batch, k) = (&batches[place / BATCH].0, place % BATCH);
            let followed = batch.first[k]..batch.first[k + 1];
            self.levers.push(batch.levers[k]);
            self.samples.extend_from_slice(&batch.samples[followed.clone()]);
            self.weights.extend_from_slice(&batch.weights[followed]);
            self.first.push(self.samples.len());
        }
        Ok(batches.iter().map(|batch| batch.1).sum())
    }

    /// Binds the points of these numbers, without keeping where they are.
    fn bind_batch(
        surface: &CarrySurface,
        points: &[DVec3],
        numbers: &[u32],
        exec: &Exec<'_>,
    ) -> Result<(Self, u64), Cancelled> {
        let mut bound = Self {
            first: vec![0],
            ..Self::default()
        };
        let mut around = Neighbourhood::default();
        for &number in numbers {
            exec.check()?;
            let point = points[number as usize];
            around.gather(surface, point);
            bound.levers.push(lever(surface, &around, point));
            bound.samples.extend(around.samples.iter().map(|s| s.0));
            bound.weights.extend(around.samples.iter().map(|s| s.1));
            bound.first.push(bound.samples.len());
        }
        Ok((bound, around.visits))
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// A point, and the samples that it follows with their weights.
    pub(super) fn followed(&self, point: usize) -> (DVec3, impl Iterator<Item = (u32, f64)>) {
        let followed = self.first[point]..self.first[point + 1];
        let weights = self.weights[followed.clone()].iter().copied();
        (self.points[point], self.samples[followed].iter().copied().zip(weights))
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Carries every point along with `motion`, in order. `motion` must be of the surface that the points were bound to.
    ///
    /// # Panics
    /// When `motion` is of a surface with fewer samples.
    pub fn carried_by(&self, motion: &SurfaceMotion, pool: &Pool) -> Vec<CarriedFrame> {
        let carry_point = |i: usize| {
            let followed = self.first[i]..self.first[i + 1];
            let samples = self.samples[followed.clone()]
                .iter()
                .zip(&self.weights[followed.clone()]);
            match followed.is_empty() {
                true => CarriedFrame::resting(self.points[i]),
                false => motion.carry_along(self.points[i], self.levers[i], samples.map(|(&s, &w)| (s, w))),
            }
        };
        pool.install(|| {
            let points = (0..self.points.len()).into_par_iter().with_min_len(BATCH);
            points.map(carry_point).collect()
        })
    }

    /// Carries the points of these numbers along, each with the gradient around it, as [`SurfaceCarrier::carry_spaces`] does and
    /// bit for bit; `carrier` and `stretch` must be of the surface that they were bound to.
    ///
    /// # Errors
    /// [`Cancelled`].
    ///
    /// # Panics
    /// For a number that is not below [`CarriedPoints::len`], and as [`CarriedPoints::carried_by`].
    pub fn spaces_along(
        &self,
        numbers: &[u32],
        carrier: &SurfaceCarrier,
        stretch: &SurfaceStretch,
        exec: &Exec<'_>,
    ) -> Result<Vec<CarriedSpace>, Cancelled> {
        let motion = &carrier.motion;
        let carry = |number: &u32| {
            let i = *number as usize;
            let followed = self.first[i]..self.first[i + 1];
            let weights = &self.weights[followed.clone()];
            let samples = || {
                self.samples[followed.clone()]
                    .iter()
                    .copied()
                    .zip(weights.iter().copied())
            };
            if followed.is_empty() {
                return CarriedSpace::resting(self.points[i]);
            }
            let frame = motion.carry_along(self.points[i], self.levers[i], samples());
            stretch.around(motion, frame, self.points[i], samples)
        };
        exec.check()?;
        Ok(exec.pool.install(|| {
            let numbers = numbers.par_iter().with_min_len(BATCH);
            numbers.map(carry).collect()
        }))
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        (self.points.capacity() + self.levers.capacity()) * size_of::<DVec3>()
            + self.first.capacity() * size_of::<usize>()
            + self.samples.capacity() * size_of::<u32>()
            + self.weights.capacity() * size_of::<f64>()
    }
}

/// Carries points of rest space along with one deformed shape of a surface.
///
/// ```
/// use glam::DVec3;
/// use pliant_asset::shapes::box_with_cells;
/// use pliant_mesh::carry::SurfaceCarrier;
/// use pliant_exec::pool::Pool;
///
/// let (rest, triangles) = box_with_cells(DVec3::ONE, [4, 4, 4]);
/// // Twice as large and moved: what is inside and what is outside follows.
/// let current: Vec<DVec3> = rest.iter().map(|p| *p * 2.0 + DVec3::X).collect();
/// let carrier = SurfaceCarrier::new(&triangles, &rest, &current, &Pool::new(1).expect("a thread"));
/// for point in [DVec3::splat(0.2), DVec3::splat(-3.0)] {
///     let carried = carrier.carry_point(point);
///     assert!(carried.position.distance(point * 2.0 + DVec3::X) < 1e-9);
///     assert!((carried.scale - 2.0).abs() < 1e-9);
/// }
/// ```
#[derive(Debug, Clone)]
pub struct SurfaceCarrier {
    surface: Arc<CarrySurface>,
    motion: SurfaceMotion,
}

impl SurfaceCarrier {
    /// Measures how the surface of `triangles` over `rest` has become `current`: a pure function of the three.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist, or `current` is shorter than `rest`.
    pub fn new(triangles: &[[u32; 3]], rest: &[DVec3], current: &[DVec3], pool: &Pool) -> Self {
        Self::of_surface(Arc::new(CarrySurface::build(rest, triangles, pool)), current, pool)
    }

    /// As [`SurfaceCarrier::new`], with a surface that is known already.
    ///
    /// # Panics
    /// When `current` is shorter than the surface has vertices.
    pub fn of_surface(surface: Arc<CarrySurface>, current: &[DVec3], pool: &Pool) -> Self {
        let motion = SurfaceMotion::between(&surface, current, pool);
        Self { surface, motion }
    }

    /// Carries one point.
    pub fn carry_point(&self, point: DVec3) -> CarriedFrame {
        self.carry_around(&mut Neighbourhood::default(), point)
    }

    /// Carries points, in order. One point takes about `log n` time; where triangles are as long as the surface it may look at each.
    ///
    /// # Errors
    /// [`Cancelled`], one point after the work was given up.
    pub fn carry_points(&self, points: &[DVec3], exec: &Exec<'_>) -> Result<Vec<CarriedFrame>, Cancelled> {
        exec.pool.install(|| {
            let points = points.par_iter().with_min_len(BATCH);
            points
                .map_init(Neighbourhood::default, |around, &point| {
                    exec.check()?;
                    Ok(self.carry_around(around, point))
                })
                .collect()
        })
    }

    /// As [`SurfaceCarrier::carry_points`], each with the gradient of the motion around it, for what has an extent.
    ///
    /// # Errors
    /// As there.
    pub fn carry_spaces(
        &self,
        stretch: &SurfaceStretch,
        points: &[DVec3],
        exec: &Exec<'_>,
    ) -> Result<Vec<CarriedSpace>, Cancelled> {
        exec.pool.install(|| {
            let points = points.par_iter().with_min_len(BATCH);
            points
                .map_init(Neighbourhood::default, |around, &point| {
                    exec.check()?;
                    let frame = self.carry_around(around, point);
                    let samples = || around.samples.iter().copied();
                    Ok(stretch.around(&self.motion, frame, point, samples))
                })
                .collect()
        })
    }

    /// Length of the diagonal of the box around the rest surface.
    pub fn diagonal(&self) -> f64 {
        self.surface.diagonal
    }

    /// How the surface has stretched.
    pub fn stretch(&self, pool: &Pool) -> SurfaceStretch {
        SurfaceStretch::of(&self.surface, &self.motion, pool)
    }

    fn carry_around(&self, around: &mut Neighbourhood, point: DVec3) -> CarriedFrame {
        around.gather(&self.surface, point);
        if around.samples.is_empty() {
            return CarriedFrame::resting(point);
        }
        let lever = lever(&self.surface, around, point);
        self.motion.carry_along(point, lever, around.samples.iter().copied())
    }
}

/// The numbers of points in an order in which those near each other follow each other: that of Morton (1966), in 1024 steps along each
/// axis.
fn order_by_place(points: &[DVec3]) -> Vec<u32> {
    const STEPS: f64 = 1023.0;
    let bounds = BoundingBox::of(points);
    let step = bounds.size().max_element() / STEPS;
    let apart = |number: f64| (0..10).fold(0u64, |all, bit| all | (number as u64 >> bit & 1) << (3 * bit));
    let key = |(point, number): (&DVec3, u32)| {
        let [x, y, z] = ((*point - bounds.min) / step).to_array().map(apart);
        ((x | y << 1 | z << 2) << 32) | u64::from(number)
    };
    let mut keys: Vec<u64> = points.iter().zip(0..).map(key).collect();
    keys.sort_unstable();
    keys.iter().map(|&key| key as u32).collect()
}

/// From the mean place of what a point follows to the point.
fn lever(surface: &CarrySurface, around: &Neighbourhood, point: DVec3) -> DVec3 {
    let place = |&(sample, weight): &(u32, f64)| (surface.sample_place(sample) - point) * weight;
    -around.samples.iter().map(place).sum::<DVec3>()
}

/// Nothing farther than this many times the distance of the surface is followed.
const REACH: f64 = 2.25;
/// Below this fraction of the diagonal a point lies on the surface.
const ON_SURFACE: f64 = 1e-9;
/// A cluster stands for its triangles where the diagonal of its box is below the first multiple of its distance, and its
/// children do where it is above the second; between the two both do, in shares, so that nothing jumps. What lies twice as
/// far as the surface weighs little and may be twice as coarse.
const FAR: [f64; 2] = [1.0, 1.4];
/// What a place of the surface still weighs whose outside is turned the wrong way.
const WRONG_SIDE: f64 = 0.01;

/// The samples that one point follows, reused from point to point.
#[derive(Debug, Default)]
pub(super) struct Neighbourhood {
    /// Samples in rising order, with weights that add to 1; empty without a surface.
    pub(super) samples: Vec<(u32, f64)>,
    /// Parts of surfaces that were looked at, for all points so far.
    pub(super) visits: u64,
    near: Vec<NearPart>,
    /// The shares of samples as they come, and the numbers by which they are sorted: the sample, and which share it is.
    parts: Vec<(u32, f64)>,
    keys: Vec<u64>,
    waiting: Vec<(u32, f64)>,
}

/// A part of the surface near a point: a triangle or a cluster.
#[derive(Debug, Clone, Copy)]
struct NearPart {
    part: SeenPart,
    weight: f64,
    /// How much it faces the point: 1 in front of it, −1 behind it.
    facing: f64,
}

#[derive(Debug, Clone, Copy)]
enum SeenPart {
    /// A triangle, at barycentric coordinates.
    Triangle(u32, [f64; 3]),
    /// A node of the tree.
    Cluster(u32),
}

impl Neighbourhood {
    /// Finds what `point` follows.
    pub(super) fn gather(&mut self, surface: &CarrySurface, point: DVec3) {
        self.samples.clear();
        self.parts.clear();
        self.near.clear();
        let Some(nearest) = surface.find_nearest(point, &mut self.visits) else {
            return;
        };
        if nearest.distance <= ON_SURFACE * surface.diagonal || !nearest.distance.is_finite() {
            self.follow_triangle(surface, nearest.triangle, nearest.corners, 1.0);
        } else {
            self.collect_near(surface, point, &nearest);
            self.share_weights(surface);
        }
        self.merge_equal();
    }

    /// Collects triangles and clusters within reach.
    fn collect_near(&mut self, surface: &CarrySurface, point: DVec3, nearest: &NearestPlace) {
        let reach = REACH * nearest.distance;
        let side = surface.sides.as_ref().and_then(|sides| sides.beside(nearest.triangle));
        self.waiting.clear();
        self.waiting.push((surface.nodes.len() as u32 - 1, 1.0));
        while let Some((index, share)) = self.waiting.pop() {
            self.visits += 1;
            let node = &surface.nodes[index as usize];
            let distance = node.distance_squared(point).sqrt();
            if distance >= reach || side.is_some_and(|side| side.hides_node(index)) {
                continue;
            }
            let merged = match side {
                Some(side) if side.divides(index) => 0.0,
                _ => share * far_share(node.diagonal, distance * (distance / nearest.distance)),
            };
            if merged > 0.0 {
                let offset = point - node.center;
                let away = offset.length().max(nearest.distance);
                self.near.push(NearPart {
                    part: SeenPart::Cluster(index),
                    weight: merged * proximity(away, nearest.distance) * seen_area(node.weight, away),
                    facing: node.normal.dot(offset) / away,
                });
            }
            let apart = share - merged;
            if apart <= 0.0 {
                continue;
            }
            let children = node.first..node.first + node.count;
            if index as usize >= surface.leaves {
                self.waiting.extend(children.rev().map(|child| (child, apart)));
                continue;
            }
            for place in children {
                if surface.balls[place as usize].is_beyond(point, reach) {
                    continue;
                }
                let triangle = surface.order[place as usize];
                if side.is_some_and(|side| side.hides(triangle)) {
                    continue;
                }
                let corners = surface.corners(triangle);
                let (weights, square) = closest_weights_on_triangle(point, corners);
                let away = square.sqrt().max(nearest.distance);
                let near = proximity(away, nearest.distance);
                let weight = near * seen_area(surface.weights[place as usize], away);
                if weight > 0.0 {
                    let normal = surface.normals[place as usize];
                    self.near.push(NearPart {
                        part: SeenPart::Triangle(triangle, weights),
                        weight: apart * weight,
                        facing: normal.dot(point - blend_corners(corners, weights)) / away,
                    });
                }
            }
        }
    }

    /// Takes weight from what faces the other way than the surface around the point does: inside a limb from the outside of
    /// its neighbour, outside of it from its far side.
    fn share_weights(&mut self, surface: &CarrySurface) {
        let (mut total, mut side) = (0.0, 0.0);
        for near in &self.near {
            total += near.weight;
            side += near.weight * near.facing;
        }
        let side = if total > 0.0 { side / total } else { 0.0 };
        for place in 0..self.near.len() {
            let near = self.near[place];
            let agreement = 0.5 * (1.0 + side * near.facing);
            let weight = near.weight * (WRONG_SIDE + agreement * agreement);
            match near.part {
                SeenPart::Cluster(node) => self.parts.push((surface.rest.len() as u32 + node, weight)),
                SeenPart::Triangle(triangle, corners) => self.follow_triangle(surface, triangle, corners, weight),
            }
        }
    }

    fn follow_triangle(&mut self, surface: &CarrySurface, triangle: u32, corners: [f64; 3], weight: f64) {
        let vertices = surface.triangles[triangle as usize];
        let used = vertices.into_iter().zip(corners).filter(|&(_, corner)| corner > 0.0);
        self.parts.extend(used.map(|(v, corner)| (v, weight * corner)));
    }

    /// Adds what belongs to one sample and makes the weights add to 1.
    fn merge_equal(&mut self) {
        // Of one sample in the order in which they came, so that sums round as they always have.
        self.keys.clear();
        let keys = (0u64..)
            .zip(&self.parts)
            .map(|(place, part)| u64::from(part.0) << 32 | place);
        self.keys.extend(keys);
        self.keys.sort_unstable();
        for &key in &self.keys {
            let (sample, weight) = self.parts[(key & u64::from(u32::MAX)) as usize];
            match self.samples.last_mut() {
                Some(kept) if kept.0 == sample => kept.1 += weight,
                _ => self.samples.push((sample, weight)),
            }
        }
        let total: f64 = self.samples.iter().map(|s| s.1).sum();
        self.samples.iter_mut().for_each(|s| s.1 /= total);
    }
}

/// The share of a cluster of this size that it stands for itself, 0 to 1, where `allowed` is how large a whole one may be.
fn far_share(size: f64, allowed: f64) -> f64 {
    let [all, none] = FAR;
    let t = ((none * allowed - size) / ((none - all) * allowed)).clamp(0.0, 1.0);
    if t.is_nan() { 0.0 } else { t * t * (3.0 - 2.0 * t) }
}

/// Falls from 1 at the distance of the surface to 0, with its slope, at the reach.
fn proximity(distance: f64, nearest: f64) -> f64 {
    let end = REACH * nearest;
    let left = ((end - distance) / ((REACH - 1.0) * distance)).max(0.0);
    left * left
}

/// The area of a part as far as it lies about as near as its nearest place: all of a small one, of a large one no more than a
/// disc as wide as it is far. Cutting a triangle into smaller ones so changes little.
fn seen_area(area: f64, distance: f64) -> f64 {
    let disc = PI * distance * distance;
    area * (disc / (area + disc))
}
