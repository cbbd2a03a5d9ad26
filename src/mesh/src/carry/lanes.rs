//! Spaces carried eight at a time in single precision, for frames.
//!
//! Where the rotations around a point contradict each other, it is carried one at a time and in double precision.

use crate::carry::carried_points::CarriedPoints;
use crate::carry::motion::SurfaceMotion;
use crate::carry::stretch::{CarriedSpace, SurfaceStretch};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Points that are carried together.
pub const LANES: usize = 8;
/// A number of each of them.
pub type Lane = [f32; LANES];

/// Numbers of a sample: displacement, rotation, logarithm of the growth, and the two sums of the gradient's fit.
const ROW: usize = 28;
/// Rotations that agree less than this are looked at in double precision.
const CLEAR: f32 = 0.91;
/// The largest logarithm of a growth for which the series of the exponential is used.
const SERIES: f32 = 1.0;

/// What every sample of a surface has in one deformed shape, in single precision and a row each.
#[derive(Debug, Clone)]
pub struct SampleRows {
    rows: Vec<[f32; ROW]>,
    motion: SurfaceMotion,
    stretch: SurfaceStretch,
}

/// Where eight points have been carried.
#[derive(Debug, Clone, Copy)]
pub struct LaneSpaces {
    /// How far each has gone, by coordinate.
    pub offset: [Lane; 3],
    /// The gradient at each, column by column.
    pub gradient: [Lane; 9],
}

impl SampleRows {
    /// Writes the rows of a motion and its stretch.
    pub fn new(motion: SurfaceMotion, stretch: SurfaceStretch, pool: &Pool) -> Self {
        let row = |sample: usize| {
            let (displacement, rotation, log_scale) = motion.sample(sample);
            let (moved, rest) = stretch.sample(sample);
            let mut row = [0.0; ROW];
            let rest = rest.to_cols_array();
            let numbers = displacement.to_array().into_iter().chain(rotation.to_cols_array());
            let numbers = numbers.chain([log_scale]).chain(moved.to_cols_array());
            // Of the symmetric sum one half.
            let numbers = numbers.chain([0, 3, 6, 4, 7, 8].map(|k| rest[k]));
            row.iter_mut()
                .zip(numbers)
                .for_each(|(out, number)| *out = number as f32);
            row
        };
        let samples = stretch.samples();
        let rows = pool.install(|| (0..samples).into_par_iter().with_min_len(256).map(row).collect());
        Self { rows, motion, stretch }
    }
}

impl CarriedPoints {
    /// Carries the points from `first` on, as many as there are lanes and points; the lanes of none stay in the rest pose.
    ///
    /// # Panics
    /// When `rows` are of a surface with fewer samples than the points were bound to.
    pub fn lane_spaces(&self, first: usize, rows: &SampleRows) -> LaneSpaces {
        let count = LANES.min(self.len().saturating_sub(first));
        let mut sums = [[0.0; LANES]; ROW];
        let mut lever = [[0.0; LANES]; 3];
        for lane in 0..count {
            let mut sum = [0.0f32; ROW];
            for (sample, weight) in self.followed(first + lane) {
                let (row, weight) = (&rows.rows[sample as usize], weight as f32);
                for (sum, number) in sum.iter_mut().zip(row) {
                    *sum += weight * number;
                }
            }
            sums.iter_mut().zip(sum).for_each(|(out, number)| out[lane] = number);
            let own = self.lever(first + lane).as_vec3().to_array();
            lever.iter_mut().zip(own).for_each(|(out, number)| out[lane] = number);
        }
        let mut spaces = LaneSpaces {
            offset: [sums[0], sums[1], sums[2]],
            gradient: fitted(&sums),
        };
        let mut rotation: [Lane; 9] = [[0.0; LANES]; 9];
        rotation.copy_from_slice(&sums[3..12]);
        let mut doubtful = [false; LANES];
        for lane in 0..LANES {
            let square: f32 = rotation.iter().map(|r| r[lane] * r[lane]).sum();
            let far = sums[12][lane].abs() > SERIES;
            let agrees = square > 3.0 * CLEAR * CLEAR;
            doubtful[lane] = !agrees || far || !spaces.gradient[0][lane].is_finite();
        }
        orthonormalise(&mut rotation);
        let scale = exponential(&sums[12]);
        for axis in 0..3 {
            for lane in 0..LANES {
                let turned = rotation[axis][lane] * lever[0][lane]
                    + rotation[3 + axis][lane] * lever[1][lane]
                    + rotation[6 + axis][lane] * lever[2][lane];
                spaces.offset[axis][lane] += turned * scale[lane] - lever[axis][lane];
            }
        }
        for lane in (0..LANES).filter(|&lane| doubtful[lane]) {
            let space = (lane < count).then(|| self.space_by(first + lane, &rows.motion, &rows.stretch));
            let rest = if lane < count {
                self.point(first + lane)
            } else {
                DVec3::ZERO
            };
            spaces.set_lane(lane, rest, space.unwrap_or(CarriedSpace::resting(rest)));
        }
        spaces
    }
}

impl LaneSpaces {
    /// Sets a lane to where a point of the rest place `rest` has been carried in double precision.
    fn set_lane(&mut self, lane: usize, rest: DVec3, space: CarriedSpace) {
        let offset = (space.frame.position - rest).to_array();
        let all = self.offset.iter_mut().chain(&mut self.gradient);
        let numbers = offset.into_iter().chain(space.gradient.to_cols_array());
        all.zip(numbers).for_each(|(out, number)| out[lane] = number as f32);
    }
}

/// The gradients of the fits: `moved` divided by `rest`.
fn fitted(sums: &[Lane; ROW]) -> [Lane; 9] {
    let mut gradient = [[0.0; LANES]; 9];
    for lane in 0..LANES {
        let [xx, xy, xz, yy, yz, zz] = [22, 23, 24, 25, 26, 27].map(|k: usize| sums[k][lane]);
        let (a, b, c) = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy);
        let part = 1.0 / (xx * a + xy * b + xz * c);
        let (e, f, i) = (xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy);
        let inverse = [[a, b, c], [b, e, f], [c, f, i]].map(|row| row.map(|v| v * part));
        for (column, inverse) in inverse.iter().enumerate() {
            for row in 0..3 {
                gradient[3 * column + row][lane] = sums[13 + row][lane] * inverse[0]
                    + sums[16 + row][lane] * inverse[1]
                    + sums[19 + row][lane] * inverse[2];
            }
        }
    }
    gradient
}

/// Makes rotations of means of rotations that agree, by Newton and Schulz's steps.
fn orthonormalise(matrix: &mut [Lane; 9]) {
    for _ in 0..3 {
        let old = *matrix;
        for lane in 0..LANES {
            let m = |column: usize, row: usize| old[3 * column + row][lane];
            let dot = |a: usize, b: usize| m(a, 0) * m(b, 0) + m(a, 1) * m(b, 1) + m(a, 2) * m(b, 2);
            let (xx, yy, zz) = (1.5 - 0.5 * dot(0, 0), 1.5 - 0.5 * dot(1, 1), 1.5 - 0.5 * dot(2, 2));
            let (xy, xz, yz) = (-0.5 * dot(0, 1), -0.5 * dot(0, 2), -0.5 * dot(1, 2));
            for row in 0..3 {
                let (x, y, z) = (m(0, row), m(1, row), m(2, row));
                matrix[row][lane] = x * xx + y * xy + z * xz;
                matrix[3 + row][lane] = x * xy + y * yy + z * yz;
                matrix[6 + row][lane] = x * xz + y * yz + z * zz;
            }
        }
    }
}

/// The exponential of numbers up to 1: a series of a quarter of it, four times multiplied with itself.
fn exponential(numbers: &Lane) -> Lane {
    let mut out = [0.0; LANES];
    for (out, number) in out.iter_mut().zip(numbers) {
        let x = 0.25 * number;
        let series = 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0)))));
        let square = series * series;
        *out = square * square;
    }
    out
}
