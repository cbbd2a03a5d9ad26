//! Points with what they follow, packed for frames: a million of them are carried, turned and stretched in some milliseconds.
//!
//! What is packed is that of [`CarriedPoints`], in single precision and without what weighs next to nothing. A shape is packed
//! once, as one record for each sample; a point then reads its weights in order, and the records from a cache.

use crate::carry::carried_points::CarriedPoints;
use crate::carry::motion::{CarrySurface, SurfaceMotion};
use crate::carry::stretch::SurfaceStretch;
use glam::{DMat3, DVec3, Mat3A, Quat, Vec3, Vec3A, Vec4};
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Samples are left out as long as all of them together weigh less than this.
const LEFT_OUT: f64 = 0.02;
/// Points that one piece of parallel work takes at most.
const BATCH: usize = 2048;
/// Where a mean of quaternions is shorter than the first they contradict each other, and below the second the rotation of the whole
/// surface says as much as they do: the lengths at which the mean of rotations has those of
/// [`CarriedPoints::carried_by`](super::CarriedPoints::carried_by).
const CONTRADICTION: [f32; 2] = [0.86, 0.78];
/// The same for the mean of gradients.
const CONTRADICTION_OF_STRETCH: [f32; 2] = [0.95, 0.86];
/// Above the larger of both nothing is looked at.
const CLEAR: f32 = 0.95;
/// Steps towards the rotation of a gradient, from that of the frame.
const MOST_STEPS: usize = 8;
/// A step of which the square is below this is the last one, radians: what is left is about its third power.
const LAST_STEP: f32 = 4e-4;
/// Up to this logarithm a series gives a scale within single precision.
const SMALL_LOGARITHM: f32 = 0.25;

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
    pub fn resting(count: usize) -> Self {
        Self {
            rotations: vec![Vec4::W; count],
            stretches: vec![Vec3::ONE; count],
            shears: vec![Vec3::ZERO; count],
        }
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
    /// Their numbers, ascending.
    vertices: Vec<u32>,
    /// From the mean place of what a point follows to it.
    levers: Vec<Vec3>,
    /// What makes a gradient of the sums of a fit: the inverse of a symmetric matrix, xx, yy, zz, yz, zx and xy.
    fits: Vec<[f32; 6]>,
    /// Where the samples of each end.
    ends: Vec<u32>,
    samples: Vec<PackedSample>,
}

#[derive(Debug, Clone, Copy)]
struct PackedSample {
    number: u32,
    weight: f32,
}

/// How the samples of a surface have moved in one shape, packed.
#[derive(Debug)]
pub struct PackedMotion {
    samples: Vec<SampleRecord>,
    whole: Vec4,
}

/// The motion of a sample.
#[derive(Debug, Clone, Copy)]
struct SampleRecord {
    /// x, y and z of the displacement, and the logarithm of the scale.
    place: Vec4,
    /// A unit quaternion.
    turn: Vec4,
    /// The sums of the fit of a gradient.
    moved: Mat3A,
}

impl SampleRecord {
    const NONE: Self = Self {
        place: Vec4::ZERO,
        turn: Vec4::ZERO,
        moved: Mat3A::ZERO,
    };
}

impl PackedMotion {
    /// Packs how `surface` has become `current`, which has one position per vertex of the surface.
    ///
    /// # Panics
    /// When `current` is shorter than the surface has vertices.
    pub fn between(surface: &CarrySurface, current: &[DVec3], pool: &Pool) -> Self {
        let motion = SurfaceMotion::between(surface, current, pool);
        let stretch = SurfaceStretch::of(surface, &motion, pool);
        let pack = |sample: usize| {
            let (displacement, turn, log_scale) = motion.of_sample(sample);
            SampleRecord {
                place: displacement.as_vec3().extend(log_scale as f32),
                turn: Vec4::from_array(turn.to_array().map(|v| v as f32)),
                moved: stretch.sums(sample).0.as_mat3().into(),
            }
        };
        let samples = pool.install(|| {
            let numbers = (0..surface.samples()).into_par_iter().with_min_len(64);
            numbers.map(pack).collect()
        });
        Self {
            samples,
            whole: Vec4::from_array(motion.whole().to_array().map(|v| v as f32)),
        }
    }
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
        heaviest.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let mut kept = 0.0;
        let mut count = 0;
        while count < heaviest.len() && kept < 1.0 - LEFT_OUT {
            kept += heaviest[count].1;
            count += 1;
        }
        heaviest.truncate(count);
        heaviest.sort_by_key(|sample| sample.0);
        let (mut mean, mut planes) = (DVec3::ZERO, DMat3::ZERO);
        for (sample, weight) in &mut heaviest {
            *weight /= kept;
            mean += surface.sample_place(*sample) * *weight;
            planes += stretch.sums(*sample as usize).1 * *weight;
        }
        let inverse = planes.inverse();
        let inverse = if inverse.is_finite() { inverse } else { DMat3::NAN };
        let number = |column: usize, row: usize| inverse.col(column)[row] as f32;
        self.vertices.push(vertex);
        self.levers.push((point - mean).as_vec3());
        self.fits.push([
            number(0, 0),
            number(1, 1),
            number(2, 2),
            number(1, 2),
            number(0, 2),
            number(0, 1),
        ]);
        let packed = |&(number, weight): &(u32, f64)| PackedSample {
            number,
            weight: weight as f32,
        };
        self.samples.extend(heaviest.iter().map(packed));
        self.ends.push(self.samples.len() as u32);
    }

    fn joined(parts: Vec<Self>) -> Self {
        let mut all = Self::default();
        let count = parts.iter().map(|part| part.vertices.len()).sum();
        all.vertices.reserve_exact(count);
        all.levers.reserve_exact(count);
        all.fits.reserve_exact(count);
        all.ends.reserve_exact(count);
        all.samples
            .reserve_exact(parts.iter().map(|part| part.samples.len()).sum());
        for part in parts {
            let before = all.samples.len() as u32;
            all.vertices.extend(part.vertices);
            all.levers.extend(part.levers);
            all.fits.extend(part.fits);
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
        size_of_val(self.vertices.as_slice())
            + size_of_val(self.levers.as_slice())
            + size_of_val(self.fits.as_slice())
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
        while begin < self.vertices.len() {
            let first = self.vertices[begin] as usize;
            let most = BATCH.min(self.vertices.len() - begin);
            let run = (1..most).find(|&k| self.vertices[begin + k] as usize != first + k);
            let run = run.unwrap_or(most);
            rest.skip_to(first);
            parts.push((begin, rest.take(run)));
            begin += run;
        }
        pool.install(|| {
            parts
                .into_par_iter()
                .for_each(|(begin, part)| self.carry_run(begin, motion, part));
        });
    }

    fn carry_run(&self, begin: usize, motion: &PackedMotion, mut to: MovedVertices<'_>) {
        let mut first = if begin == 0 { 0 } else { self.ends[begin - 1] as usize };
        let count = to.rotations.len();
        for base in (0..count).step_by(LANES) {
            let lanes = LANES.min(count - base);
            let mut sums = [FollowedMeans::RESTING; LANES];
            for (k, sums) in sums[..lanes].iter_mut().enumerate() {
                let i = begin + base + k;
                let end = self.ends[i] as usize;
                *sums = motion.sums(&self.samples[first..end], self.levers[i], &self.fits[i]);
                first = end;
            }
            let carried = PointLanes::of(&sums).carried();
            for k in 0..lanes {
                let i = base + k;
                if let Some(positions) = &mut to.positions {
                    positions[i] += carried.moved.of(k).as_dvec3();
                }
                let [x, y, z, w] = carried.turn.map(|lane| lane[k]);
                to.rotations[i] = Vec4::new(x, y, z, w);
                to.stretches[i] = carried.stretch.of(k);
                to.shears[i] = carried.shear.of(k);
            }
        }
    }
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

/// The means of what a point follows.
#[derive(Debug, Clone, Copy)]
struct FollowedMeans {
    displacement: Vec3,
    scale: f32,
    /// About a unit quaternion.
    turn: Vec4,
    lever: Vec3,
    gradient: Mat3A,
}

impl FollowedMeans {
    /// Of a point that has not moved.
    const RESTING: Self = Self {
        displacement: Vec3::ZERO,
        scale: 1.0,
        turn: Vec4::W,
        lever: Vec3::ZERO,
        gradient: Mat3A::IDENTITY,
    };
}

impl PackedMotion {
    #[inline]
    fn sums(&self, samples: &[PackedSample], lever: Vec3, fit: &[f32; 6]) -> FollowedMeans {
        let Some(one) = samples.first() else {
            return FollowedMeans::RESTING;
        };
        let side = self.samples[one.number as usize].turn;
        let mut sum = SampleRecord::NONE;
        for &PackedSample { number, weight } in samples {
            let sample = &self.samples[number as usize];
            let signed = if sample.turn.dot(side) < 0.0 { -weight } else { weight };
            sum.place += sample.place * weight;
            sum.turn += sample.turn * signed;
            sum.moved.x_axis += sample.moved.x_axis * weight;
            sum.moved.y_axis += sample.moved.y_axis * weight;
            sum.moved.z_axis += sample.moved.z_axis * weight;
        }
        let agreement = sum.turn.length_squared();
        let scale = exponential(sum.place.w);
        let [xx, yy, zz, yz, zx, xy] = *fit;
        let inverse = Mat3A::from_cols(Vec3A::new(xx, xy, zx), Vec3A::new(xy, yy, yz), Vec3A::new(zx, yz, zz));
        let mut gradient = sum.moved * inverse;
        // Rare: rotations that contradict each other, and sums that determine no gradient.
        if agreement < CLEAR * CLEAR || !gradient.is_finite() {
            let agreement = agreement.sqrt();
            let doubt = |[clear, vague]: [f32; 2]| ((clear - agreement) / (clear - vague)).clamp(0.0, 1.0);
            let whole = if self.whole.dot(sum.turn) < 0.0 {
                -self.whole
            } else {
                self.whole
            };
            sum.turn += whole * (0.5 * doubt(CONTRADICTION));
            let unsure = doubt(CONTRADICTION_OF_STRETCH);
            let similar = Mat3A::from_quat(Quat::from_vec4(sum.turn).normalize()) * scale;
            let mixed = gradient * (1.0 - unsure) + similar * unsure;
            gradient = if mixed.is_finite() { mixed } else { similar };
        }
        FollowedMeans {
            displacement: sum.place.truncate(),
            scale,
            turn: sum.turn,
            lever,
            gradient,
        }
    }
}

/// The exponential function, without a call near 0.
#[inline]
fn exponential(x: f32) -> f32 {
    if x.abs() > SMALL_LOGARITHM {
        return libm::expf(x);
    }
    1.0 + x * (1.0 + x * (1.0 / 2.0 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0)))))
}

/// Points that are taken at once, one in each lane of a vector.
const LANES: usize = 4;

/// Three numbers of each point.
#[derive(Debug, Clone, Copy)]
struct Lanes3([Vec4; 3]);

impl Lanes3 {
    /// One vector of each point.
    #[inline]
    fn across([a, b, c, d]: [Vec3; LANES]) -> Self {
        Self([
            Vec4::new(a.x, b.x, c.x, d.x),
            Vec4::new(a.y, b.y, c.y, d.y),
            Vec4::new(a.z, b.z, c.z, d.z),
        ])
    }

    #[inline]
    fn of(self, lane: usize) -> Vec3 {
        Vec3::from_array(self.0.map(|number| number[lane]))
    }

    #[inline]
    fn dot(self, other: Self) -> Vec4 {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        a * x + b * y + c * z
    }

    #[inline]
    fn cross(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([b * z - c * y, c * x - a * z, a * y - b * x])
    }
}

/// Points on their way.
struct PointLanes {
    displacement: Lanes3,
    scale: Vec4,
    turn: [Vec4; 4],
    lever: Lanes3,
    /// By columns.
    gradient: [Lanes3; 3],
}

/// What becomes of points.
struct CarriedLanes {
    moved: Lanes3,
    /// w is 0 or more.
    turn: [Vec4; 4],
    stretch: Lanes3,
    shear: Lanes3,
}

impl PointLanes {
    #[inline]
    fn of(sums: &[FollowedMeans; LANES]) -> Self {
        Self {
            displacement: Lanes3::across(sums.each_ref().map(|s| s.displacement)),
            scale: Vec4::from_array(sums.each_ref().map(|s| s.scale)),
            turn: std::array::from_fn(|k| Vec4::from_array(sums.each_ref().map(|s| s.turn[k]))),
            lever: Lanes3::across(sums.each_ref().map(|s| s.lever)),
            gradient: [
                Lanes3::across(sums.each_ref().map(|s| s.gradient.x_axis.into())),
                Lanes3::across(sums.each_ref().map(|s| s.gradient.y_axis.into())),
                Lanes3::across(sums.each_ref().map(|s| s.gradient.z_axis.into())),
            ],
        }
    }

    #[inline]
    fn carried(&self) -> CarriedLanes {
        let mut turn = unit(self.turn);
        let rows = rows_of(turn);
        let ([dx, dy, dz], [lx, ly, lz]) = (self.displacement.0, self.lever.0);
        let turned = rows.map(|row| row.dot(self.lever) * self.scale);
        let moved = Lanes3([dx + (turned[0] - lx), dy + (turned[1] - ly), dz + (turned[2] - lz)]);
        let mut left = self.turned_back(turn);
        for _ in 0..MOST_STEPS {
            let (step, size) = step_of(&left);
            let [x, y, z] = (step.0).map(|number| number * 0.5);
            let [a, b, c, d] = turn;
            // The product of quaternions, of which the second one has w of 1.
            turn = unit([
                a + d * x + b * z - c * y,
                b + d * y + c * x - a * z,
                c + d * z + a * y - b * x,
                d - a * x - b * y - c * z,
            ]);
            left = self.turned_back(turn);
            if size.max_element() < LAST_STEP {
                break;
            }
        }
        let side = turn[3].cmplt(Vec4::ZERO);
        let half = Vec4::splat(0.5);
        CarriedLanes {
            moved,
            turn: turn.map(|number| Vec4::select(side, -number, number)),
            stretch: Lanes3([left[0].0[0], left[1].0[1], left[2].0[2]]),
            shear: Lanes3([
                (left[1].0[2] + left[2].0[1]) * half,
                (left[2].0[0] + left[0].0[2]) * half,
                (left[0].0[1] + left[1].0[0]) * half,
            ]),
        }
    }

    /// The gradients without these rotations, by columns.
    #[inline]
    fn turned_back(&self, turn: [Vec4; 4]) -> [Lanes3; 3] {
        let rows = rows_of(turn);
        // The columns of the rotation are the rows of its inverse.
        let axes: [Lanes3; 3] = std::array::from_fn(|k| Lanes3(rows.map(|row| row.0[k])));
        self.gradient.map(|column| Lanes3(axes.map(|axis| axis.dot(column))))
    }
}

/// Quaternions of length 1.
#[inline]
fn unit(turn: [Vec4; 4]) -> [Vec4; 4] {
    let [x, y, z, w] = turn;
    let length = (x * x + y * y + z * z + w * w).max(Vec4::splat(f32::MIN_POSITIVE));
    let part = Vec4::from_array(length.to_array().map(|square| 1.0 / square.sqrt()));
    turn.map(|number| number * part)
}

/// The rows of rotation matrices.
#[inline]
fn rows_of([x, y, z, w]: [Vec4; 4]) -> [Lanes3; 3] {
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let one = Vec4::ONE;
    [
        Lanes3([one - (y * y2 + z * z2), x * y2 - w * z2, x * z2 + w * y2]),
        Lanes3([x * y2 + w * z2, one - (x * x2 + z * z2), y * z2 - w * x2]),
        Lanes3([x * z2 - w * y2, y * z2 + w * x2, one - (x * x2 + y * y2)]),
    ]
}

/// A step from what is left of gradients towards their rotation, as [`nearest_rotation`](crate::rotation::nearest_rotation) takes it,
/// and its square.
#[inline]
fn step_of(left: &[Lanes3; 3]) -> (Lanes3, Vec4) {
    let [Lanes3([xx, yx, zx]), Lanes3([xy, yy, zy]), Lanes3([xz, yz, zz])] = *left;
    let slope = Lanes3([zy - yz, xz - zx, yx - xy]);
    let half = Vec4::splat(-0.5);
    let (a, b, c) = ((yz + zy) * half, (zx + xz) * half, (xy + yx) * half);
    let curve = [
        Lanes3([yy + zz, c, b]),
        Lanes3([c, xx + zz, a]),
        Lanes3([b, a, xx + yy]),
    ];
    // Cramer's rule.
    let across = curve[1].cross(curve[2]);
    let determinant = curve[0].dot(across);
    let parts = [across, curve[2].cross(curve[0]), curve[0].cross(curve[1])].map(|part| slope.dot(part));
    let newton = Lanes3(parts.map(|part| part / determinant));
    let size = newton.dot(newton);
    // Where the curve is not positive, along the slope by no more than can be right.
    let is_short = determinant.cmpgt(Vec4::ZERO) & size.cmplt(Vec4::ONE);
    let length = Vec4::from_array(slope.dot(slope).to_array().map(f32::sqrt));
    let careful = (xx + yy + zz).abs() + length + Vec4::splat(f32::MIN_POSITIVE);
    let step: [Vec4; 3] = std::array::from_fn(|k| Vec4::select(is_short, newton.0[k], slope.0[k] / careful));
    let step = Lanes3(step);
    (step, step.dot(step))
}
