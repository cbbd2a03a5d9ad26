//! Points with what they follow, packed for frames: a million of them are carried, turned and stretched in some tens of milliseconds.
//!
//! What is packed is that of [`CarriedPoints`], in single precision and without what weighs little. A shape is packed once, as one
//! record for each sample; a point then reads its weights in order, and the records from a cache.

use crate::carry::carried_points::CarriedPoints;
use crate::carry::motion::{CarrySurface, SurfaceMotion};
use crate::carry::packed_lanes::{CarriedLanes, LANES, Lanes3, PointLanes, across};
use crate::carry::packed_motion::{AgreedMotion, CLEAR, MeanMotion, PackedMotion, PackedSample};
use crate::carry::stretch::SurfaceStretch;
use crate::rotation::outer_product;
use glam::{DMat3, DVec3, Mat3A, Vec3, Vec3A, Vec4};
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Samples are left out as long as all of them together weigh less than this; those that stay then weigh so much that their mean
/// place is the same.
const LEFT_OUT: f64 = 0.1;
/// A spread below this fraction of the whole one is none: in that direction the weights of those that stay keep no mean place.
const LEAST_SPREAD: f64 = 0.01;
/// A sample that stays loses no more than this fraction of its weight.
const MOST_LOST: f64 = 0.9;
/// Points that one piece of parallel work takes at most.
const BATCH: usize = 2048;

/// How space around render vertices has turned and stretched: one of each for every vertex.
///
/// The gradient of the motion at a vertex is `R·U`, of the rotation `R` and the symmetric stretch `U`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LocalGradients {
    /// Unit quaternions x, y, z, w with w of 0 or more.
    pub rotations: Vec<Vec4>,
    /// xx, yy and zz of the stretch.
    pub stretches: Vec<Vec3>,
    /// yz, zx and xy of the stretch.
    pub shears: Vec<Vec3>,
}

impl LocalGradients {
    /// Of so many vertices around which nothing has moved.
    pub fn resting(count: usize, pool: &Pool) -> Self {
        fn filled<T: Copy + Send + Sync>(value: T, count: usize) -> Vec<T> {
            let vertices = (0..count).into_par_iter().with_min_len(BATCH);
            vertices.map(|_| value).collect()
        }
        // Fresh memory costs more than what is written to it: threads share that.
        pool.install(|| Self {
            rotations: filled(Vec4::W, count),
            stretches: filled(Vec3::ONE, count),
            shears: filled(Vec3::ZERO, count),
        })
    }

    /// Gives a vertex what another one has.
    pub fn copy(&mut self, vertex: usize, like: usize) {
        self.rotations[vertex] = self.rotations[like];
        self.stretches[vertex] = self.stretches[like];
        self.shears[vertex] = self.shears[like];
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        self.rotations.capacity() * size_of::<Vec4>()
            + (self.stretches.capacity() + self.shears.capacity()) * size_of::<Vec3>()
    }
}

/// Vertices with what they follow.
#[derive(Debug, Clone, Default)]
pub struct PackedPoints {
    /// Of vertices that rise one by one, all points in order.
    runs: Vec<PackedRun>,
    points: Vec<PackedPoint>,
    /// Where the samples of each end.
    ends: Vec<u32>,
    samples: Vec<PackedSample>,
}

/// Points of vertices that rise one by one, at most [`BATCH`].
#[derive(Debug, Clone, Copy)]
struct PackedRun {
    vertex: u32,
    count: u32,
}

/// A point that is carried.
#[derive(Debug, Clone, Copy)]
struct PackedPoint {
    /// From the mean place of what it follows to it.
    lever: [f32; 3],
    /// What makes a gradient of the sums of a fit: the inverse of a symmetric matrix, xx, yy, zz, yz, zx and xy.
    fit: [f32; 6],
}

impl PackedPoints {
    /// Packs points of these vertices, which rise.
    pub fn pack(points: &CarriedPoints, vertices: &[u32], surface: &CarrySurface, pool: &Pool) -> Self {
        let mut order: Vec<usize> = (0..points.len().min(vertices.len())).collect();
        order.sort_by_key(|&k| vertices[k]);
        let parts: Vec<Self> = pool.install(|| {
            let rest = SurfaceMotion::between(surface, surface.rest_places(), pool);
            let stretch = SurfaceStretch::of(surface, &rest, pool);
            let parts = order.par_chunks(BATCH);
            parts
                .map(|part| {
                    let mut packed = Self::default();
                    for &k in part {
                        let (point, followed) = points.followed(k);
                        packed.push(vertices[k], point, followed.collect(), surface, &stretch);
                    }
                    packed
                })
                .collect()
        });
        Self::joined(parts)
    }

    /// Packs vertices that lie at a vertex of the surface each: pairs of both, of which the first rise.
    pub fn at_vertices(pairs: &[(u32, u32)], surface: &CarrySurface, pool: &Pool) -> Self {
        let rest = SurfaceMotion::between(surface, surface.rest_places(), pool);
        let stretch = SurfaceStretch::of(surface, &rest, pool);
        let mut packed = Self::default();
        for &(vertex, sample) in pairs {
            let place = surface.sample_place(sample);
            packed.push(vertex, place, vec![(sample, 1.0)], surface, &stretch);
        }
        packed
    }

    /// Adds a point, with the samples that it follows and their weights.
    fn push(
        &mut self,
        vertex: u32,
        point: DVec3,
        mut heaviest: Vec<(u32, f64)>,
        surface: &CarrySurface,
        stretch: &SurfaceStretch,
    ) {
        leave_out_light(&mut heaviest, surface);
        let (mut mean, mut planes) = (DVec3::ZERO, DMat3::ZERO);
        for &(sample, weight) in &heaviest {
            mean += surface.sample_place(sample) * weight;
            planes += stretch.sums(sample as usize).1 * weight;
        }
        let inverse = planes.inverse();
        let inverse = if inverse.is_finite() { inverse } else { DMat3::NAN };
        let number = |column: usize, row: usize| inverse.col(column)[row] as f32;
        self.points.push(PackedPoint {
            lever: (point - mean).as_vec3().to_array(),
            fit: [
                number(0, 0),
                number(1, 1),
                number(2, 2),
                number(1, 2),
                number(0, 2),
                number(0, 1),
            ],
        });
        let packed = |&(number, weight): &(u32, f64)| PackedSample {
            number,
            weight: weight as f32,
        };
        self.samples.extend(heaviest.iter().map(packed));
        self.ends.push(self.samples.len() as u32);
        match self.runs.last_mut() {
            Some(run) if run.vertex + run.count == vertex && (run.count as usize) < BATCH => run.count += 1,
            _ => self.runs.push(PackedRun { vertex, count: 1 }),
        }
    }

    fn joined(parts: Vec<Self>) -> Self {
        let mut all = Self::default();
        let count = parts.iter().map(|part| part.points.len()).sum();
        all.points.reserve_exact(count);
        all.ends.reserve_exact(count);
        all.samples
            .reserve_exact(parts.iter().map(|part| part.samples.len()).sum());
        for part in parts {
            let before = all.samples.len() as u32;
            all.runs.extend(part.runs);
            all.points.extend(part.points);
            all.ends.extend(part.ends.iter().map(|end| before + end));
            all.samples.extend(part.samples);
        }
        all
    }

    /// How many samples the points follow together.
    pub fn samples(&self) -> usize {
        self.samples.len()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        size_of_val(self.runs.as_slice())
            + size_of_val(self.points.as_slice())
            + size_of_val(self.ends.as_slice())
            + size_of_val(self.samples.as_slice())
    }

    /// Carries the points along with `motion`: adds what they have moved by to `positions`, which are those of rest, and writes how
    /// space around them has turned and stretched. Without `positions` they stay.
    ///
    /// # Panics
    /// When `motion` is of another surface, or there are fewer positions or gradients than vertices.
    pub fn carry(
        &self,
        motion: &PackedMotion,
        positions: Option<&mut [DVec3]>,
        gradients: &mut LocalGradients,
        pool: &Pool,
    ) {
        let mut parts = Vec::new();
        let mut rest = MovedVertices {
            first: 0,
            positions,
            rotations: &mut gradients.rotations,
            stretches: &mut gradients.stretches,
            shears: &mut gradients.shears,
        };
        let mut begin = 0;
        for run in &self.runs {
            rest.skip_to(run.vertex as usize);
            parts.push((begin, rest.take(run.count as usize)));
            begin += run.count as usize;
        }
        pool.install(|| {
            parts
                .into_par_iter()
                .for_each(|(begin, part)| self.carry_run(begin, motion, part));
        });
    }

    fn carry_run(&self, begin: usize, motion: &PackedMotion, mut to: MovedVertices<'_>) {
        let count = to.rotations.len();
        for base in (0..count).step_by(LANES) {
            let lanes = LANES.min(count - base);
            let carried = self.carried(begin + base, lanes, motion);
            let moved = carried.moved.each();
            let turn = across(carried.turn);
            let (stretch, shear) = (carried.stretch.each(), carried.shear.each());
            for k in 0..lanes {
                let i = base + k;
                if let Some(positions) = &mut to.positions {
                    positions[i] += moved[k].as_dvec3();
                }
                to.rotations[i] = turn[k];
                to.stretches[i] = stretch[k];
                to.shears[i] = shear[k];
            }
        }
    }

    /// Carries a point for each lane from `first` on; beyond so many lanes the last one again.
    #[inline]
    fn carried(&self, first: usize, lanes: usize, motion: &PackedMotion) -> CarriedLanes {
        let mut begin = if first == 0 { 0 } else { self.ends[first - 1] as usize };
        let mut followed: [&[PackedSample]; LANES] = [&[]; LANES];
        for (k, followed) in followed.iter_mut().enumerate().take(lanes) {
            let end = self.ends[first + k] as usize;
            *followed = &self.samples[begin..end];
            begin = end;
        }
        for k in lanes..LANES {
            followed[k] = followed[lanes - 1];
        }
        let means = followed.map(|samples| motion.mean(samples));
        let points: [&PackedPoint; LANES] = std::array::from_fn(|k| &self.points[first + k.min(lanes - 1)]);
        let mut lanes = packed_lanes(&means, &points);
        let agree = lanes.agree(CLEAR);
        if !agree.all() {
            for k in (0..LANES).filter(|&k| !agree.test(k)) {
                let AgreedMotion { turn, gradient } = motion.agreed(followed[k], &means[k], points[k].inverse());
                for (lane, number) in lanes.turn.iter_mut().zip(turn.to_array()) {
                    lane[k] = number;
                }
                for (lane, column) in lanes.gradient.iter_mut().zip(gradient.to_cols_array_2d()) {
                    lane.0
                        .iter_mut()
                        .zip(column)
                        .for_each(|(lane, number)| lane[k] = number);
                }
            }
        }
        lanes.carried()
    }
}

impl PackedPoint {
    fn inverse(&self) -> Mat3A {
        let [xx, yy, zz, yz, zx, xy] = self.fit;
        Mat3A::from_cols(Vec3A::new(xx, xy, zx), Vec3A::new(xy, yy, yz), Vec3A::new(zx, yz, zz))
    }
}

/// Puts points into lanes, each with the mean motion of what it follows.
#[inline]
fn packed_lanes(means: &[MeanMotion; LANES], points: &[&PackedPoint; LANES]) -> PointLanes {
    let column = |k: usize| across(means.each_ref().map(|mean| mean.sums.columns[k]));
    let columns = [column(0), column(1), column(2)];
    let fit = |k: usize| Vec4::from_array(points.map(|point| point.fit[k]));
    let [xx, yy, zz, yz, zx, xy] = [fit(0), fit(1), fit(2), fit(3), fit(4), fit(5)];
    let times = |x: Vec4, y: Vec4, z: Vec4| {
        let [a, b, c] = columns;
        Lanes3(std::array::from_fn(|k| a[k] * x + b[k] * y + c[k] * z))
    };
    PointLanes {
        displacement: Lanes3(columns.map(|column| column[3])),
        log_scale: Vec4::from_array(means.each_ref().map(|mean| mean.log_scale)),
        turn: across(means.each_ref().map(|mean| mean.sums.turn)),
        lever: Lanes3(std::array::from_fn(|k| {
            Vec4::from_array(points.map(|point| point.lever[k]))
        })),
        gradient: [times(xx, xy, zx), times(xy, yy, yz), times(zx, yz, zz)],
    }
}

/// Leaves out what weighs little, of samples with weights that add to 1, and sorts the others. Those keep the mean place, as far as
/// their spread allows, so that a motion that is affine around a point stays what it is.
fn leave_out_light(samples: &mut Vec<(u32, f64)>, surface: &CarrySurface) {
    let mean_of = |samples: &[(u32, f64)]| -> DVec3 {
        let places = samples
            .iter()
            .map(|&(sample, weight)| surface.sample_place(sample) * weight);
        places.sum()
    };
    let all = mean_of(samples);
    samples.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let mut kept = 0.0;
    let mut count = 0;
    while count < samples.len() && kept < 1.0 - LEFT_OUT {
        kept += samples[count].1;
        count += 1;
    }
    let is_whole = count == samples.len();
    samples.truncate(count);
    samples.sort_by_key(|sample| sample.0);
    samples.iter_mut().for_each(|(_, weight)| *weight /= kept);
    if is_whole {
        return;
    }
    let mean = mean_of(samples);
    let from_mean = |sample: u32| surface.sample_place(sample) - mean;
    let mut spread = DMat3::ZERO;
    for &(sample, weight) in samples.iter() {
        spread += outer_product(from_mean(sample), from_mean(sample)) * weight;
    }
    let least = LEAST_SPREAD * (spread.x_axis.x + spread.y_axis.y + spread.z_axis.z);
    let slope = (spread + DMat3::from_diagonal(DVec3::splat(least))).inverse() * (all - mean);
    if !slope.is_finite() {
        return;
    }
    let changes = samples.iter().map(|&(sample, _)| slope.dot(from_mean(sample)));
    let most_lost = changes.fold(MOST_LOST, |most, change| most.max(-change));
    let slope = slope * (MOST_LOST / most_lost);
    let mut sum = 0.0;
    for (sample, weight) in samples.iter_mut() {
        *weight *= 1.0 + slope.dot(from_mean(*sample));
        sum += *weight;
    }
    samples.iter_mut().for_each(|(_, weight)| *weight /= sum);
}

/// A run of vertices that are written.
struct MovedVertices<'a> {
    first: usize,
    positions: Option<&'a mut [DVec3]>,
    rotations: &'a mut [Vec4],
    stretches: &'a mut [Vec3],
    shears: &'a mut [Vec3],
}

impl<'a> MovedVertices<'a> {
    fn skip_to(&mut self, vertex: usize) {
        self.take(vertex - self.first);
    }

    /// Takes the first `count` off.
    fn take(&mut self, count: usize) -> Self {
        fn split<'a, T>(from: &mut &'a mut [T], count: usize) -> &'a mut [T] {
            let (first, rest) = std::mem::take(from).split_at_mut(count);
            *from = rest;
            first
        }
        let taken = Self {
            first: self.first,
            positions: self.positions.as_mut().map(|positions| split(positions, count)),
            rotations: split(&mut self.rotations, count),
            stretches: split(&mut self.stretches, count),
            shears: split(&mut self.shears, count),
        };
        self.first += count;
        taken
    }
}
