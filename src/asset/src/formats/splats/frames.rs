//! Splats in one frame after another: bound to a surface once, then carried in single precision, eight at a time.

use super::cloud::Splats;
use glam::{DQuat, DVec3};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Cancelled;
use pliant_mesh::carry::{CarriedPoints, CarrySurface, LANES, Lane, LaneSpaces, SampleRows};
use rayon::prelude::*;

/// Splats that one piece of parallel work takes.
const BATCH: usize = 64 * LANES;
/// Rounds of turning axes against each other; one more than a stretch by two needs in single precision.
const ROUNDS: usize = 4;
/// Below this square of a cosine axes count as perpendicular.
const PERPENDICULAR: f32 = 1e-11;

/// A splat in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SplatFrame {
    /// Its centre.
    pub center: [f32; 3],
    /// The rotation of its axes, x, y, z, w. Viewers turn the direction of sight back by what it is beyond the rest pose, instead of
    /// turning spherical harmonics.
    pub turn: [f32; 4],
    /// Standard deviations along the axes.
    pub scale: [f32; 3],
}

/// Splats that follow a surface from frame to frame. Files are written by way of [`Splats::carry`], which is exact.
#[derive(Debug)]
pub struct SplatFrames {
    points: CarriedPoints,
    /// The axes of each in the rest pose, the longest of length 1: for each group of lanes nine numbers, column by column.
    axes: Vec<[Lane; 9]>,
    /// How long the longest is.
    sizes: Vec<Lane>,
}

impl SplatFrames {
    /// Finds what each splat follows on `surface`.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn bind(splats: &Splats, surface: &CarrySurface, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let points = CarriedPoints::bind(surface, splats.centers(), exec)?;
        let groups = splats.len().div_ceil(LANES);
        let (mut axes, mut sizes) = (vec![[[0.0; LANES]; 9]; groups], vec![[0.0; LANES]; groups]);
        for (i, shape) in splats.shapes.iter().enumerate().filter(|(_, shape)| shape.is_sound()) {
            let turn = DQuat::from_array(shape.turn.map(f64::from));
            let scale = shape.log_scale.map(|s| libm::exp(f64::from(s)));
            let size = scale.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            sizes[i / LANES][i % LANES] = size as f32;
            let columns = [0, 1, 2].map(|k| turn * DVec3::AXES[k] * (scale[k] / size));
            let numbers = columns.iter().flat_map(|column| column.to_array());
            let group = &mut axes[i / LANES];
            group
                .iter_mut()
                .zip(numbers)
                .for_each(|(out, v)| out[i % LANES] = v as f32);
        }
        Ok(Self { points, axes, sizes })
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.points.byte_size() + size_of_val(self.axes.as_slice()) + size_of_val(self.sizes.as_slice())
    }

    /// Writes where all are in a shape, in order; the same bits for any number of threads.
    ///
    /// # Panics
    /// When `out` is not of one entry for each splat, or `rows` are of another surface.
    pub fn write(&self, rows: &SampleRows, out: &mut [SplatFrame], pool: &Pool) {
        assert_eq!(out.len(), self.points.len(), "one entry for each splat");
        pool.install(|| {
            let batches = out.par_chunks_mut(BATCH).enumerate();
            batches.for_each(|(batch, out)| {
                for (group, out) in out.chunks_mut(LANES).enumerate() {
                    let first = batch * BATCH + group * LANES;
                    let spaces = self.points.lane_spaces(first, rows);
                    let (turn, scale) = shapes_in(&spaces, &self.axes[first / LANES]);
                    let size = &self.sizes[first / LANES];
                    for (lane, out) in out.iter_mut().enumerate() {
                        let rest = self.points.point(first + lane);
                        for axis in 0..3 {
                            out.center[axis] = (rest[axis] + f64::from(spaces.offset[axis][lane])) as f32;
                        }
                        out.turn = turn.map(|part| part[lane]);
                        out.scale = scale.map(|part| part[lane] * size[lane]);
                    }
                }
            });
        });
    }
}

/// Rotations and standard deviations of ellipsoids after a motion.
fn shapes_in(spaces: &LaneSpaces, rest: &[Lane; 9]) -> ([Lane; 4], [Lane; 3]) {
    let mut axes = [[0.0; LANES]; 9];
    let gradient = &spaces.gradient;
    for column in 0..3 {
        for row in 0..3 {
            for lane in 0..LANES {
                axes[3 * column + row][lane] = gradient[row][lane] * rest[3 * column][lane]
                    + gradient[3 + row][lane] * rest[3 * column + 1][lane]
                    + gradient[6 + row][lane] * rest[3 * column + 2][lane];
            }
        }
    }
    for _ in 0..ROUNDS {
        let mut worst = false;
        for (a, b) in [(0, 3), (0, 6), (3, 6)] {
            worst |= turn_pair(&mut axes, a, b);
        }
        if !worst {
            break;
        }
    }
    let mut scale = [[0.0; LANES]; 3];
    for column in 0..3 {
        for lane in 0..LANES {
            let [x, y, z] = [0, 1, 2].map(|row| axes[3 * column + row][lane]);
            let length = (x * x + y * y + z * z).sqrt();
            scale[column][lane] = length;
            let part = if length > 0.0 { 1.0 / length } else { 0.0 };
            for row in 0..3 {
                axes[3 * column + row][lane] *= part;
            }
        }
    }
    (turns_of(&axes), scale)
}

/// Turns two axes until they are perpendicular. Answers whether some were not.
fn turn_pair(axes: &mut [Lane; 9], a: usize, b: usize) -> bool {
    let mut worst = false;
    for lane in 0..LANES {
        let (ax, ay, az) = (axes[a][lane], axes[a + 1][lane], axes[a + 2][lane]);
        let (bx, by, bz) = (axes[b][lane], axes[b + 1][lane], axes[b + 2][lane]);
        let (aa, bb) = (ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz);
        let ab = ax * bx + ay * by + az * bz;
        let skew = ab * ab > PERPENDICULAR * aa * bb;
        worst |= skew;
        let half = 0.5 * (bb - aa);
        let root = (half * half + ab * ab).sqrt();
        let tangent = ab / (half + if half < 0.0 { -root } else { root });
        let tangent = if skew { tangent } else { 0.0 };
        let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
        let sine = cosine * tangent;
        (axes[a][lane], axes[b][lane]) = (ax * cosine - bx * sine, ax * sine + bx * cosine);
        (axes[a + 1][lane], axes[b + 1][lane]) = (ay * cosine - by * sine, ay * sine + by * cosine);
        (axes[a + 2][lane], axes[b + 2][lane]) = (az * cosine - bz * sine, az * sine + bz * cosine);
    }
    worst
}

/// The rotations with these axes. The third is taken across the others, which also gives a flat splat one.
fn turns_of(axes: &[Lane; 9]) -> [Lane; 4] {
    let mut turns = [[0.0; LANES]; 4];
    for lane in 0..LANES {
        let m = |k: usize| axes[k][lane];
        let (xx, xy, xz, yx, yy, yz) = (m(0), m(1), m(2), m(3), m(4), m(5));
        let (zx, zy, zz) = (xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx);
        // Four times the square of each part; the largest is divided by.
        let squares = [
            1.0 + xx - yy - zz,
            1.0 - xx + yy - zz,
            1.0 - xx - yy + zz,
            1.0 + xx + yy + zz,
        ];
        let rows = [
            [squares[0], xy + yx, zx + xz, yz - zy],
            [xy + yx, squares[1], yz + zy, zx - xz],
            [zx + xz, yz + zy, squares[2], xy - yx],
            [yz - zy, zx - xz, xy - yx, squares[3]],
        ];
        let mut best = 3;
        for k in 0..3 {
            if squares[k] > squares[best] {
                best = k;
            }
        }
        let part = 0.5 / squares[best].max(f32::MIN_POSITIVE).sqrt();
        for (turn, number) in turns.iter_mut().zip(rows[best]) {
            turn[lane] = number * part;
        }
    }
    turns
}
