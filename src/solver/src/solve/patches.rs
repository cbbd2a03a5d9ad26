//! The original equations on one level, whose rows carry their members along as affine patches.
//!
//! The rotational part of a matrix, and how it turns linear maps.
//!
//! Four matrices at a time take three Newton steps in single precision. The few that need more (inverted, flat, or far from what they
//! are compared with) are looked at one by one, in double precision.

use std::ops::{Add, Mul, Sub};

use crate::lanes::resize_untouched;
use crate::lanes::{Lanes, WIDTH, prefetch};

/// A linear map by its columns.
pub(crate) type PatchMap = [Lanes; 3];

/// The original equations on one level.
#[derive(Debug, Default)]
pub(crate) struct AffinePatches {
    /// F of each row, or empty.
    pub(crate) maps: Vec<PatchMap>,
    pub(crate) positions: Vec<Lanes>,
    /// β of equation (12).
    pub(crate) beta: Vec<Lanes>,
    /// Given values on masked rows, the solution on free ones.
    pub(crate) x: Vec<Lanes>,
}

impl AffinePatches {
    pub(crate) fn byte_size(&self) -> usize {
        48 * self.maps.capacity() + 16 * (self.positions.capacity() + self.beta.capacity() + self.x.capacity())
    }

    pub(crate) fn resize(&mut self, rows: usize, mapped: bool) {
        let mapped = if mapped { rows } else { 0 };
        resize_untouched(&mut self.maps, mapped);
        resize_untouched(&mut self.positions, mapped);
        resize_untouched(&mut self.beta, rows);
        resize_untouched(&mut self.x, rows);
    }

    /// Asks memory for these rows.
    #[inline(always)]
    pub(crate) fn prefetch(&self, rows: &[u32]) {
        for i in rows.iter().map(|&i| i as usize) {
            if !self.maps.is_empty() {
                prefetch(&self.maps, i);
                prefetch(&self.positions, i);
            }
            prefetch(&self.beta, i);
            prefetch(&self.x, i);
        }
    }

    /// map · (p − centre) for a row's position p.
    #[inline(always)]
    pub(crate) fn offset(&self, map: &PatchMap, row: usize, centre: Lanes) -> Lanes {
        times(map, self.positions[row] - centre)
    }

    /// d_ij = ½ (F_i + F_j) (p_i − p_j), 0 without maps.
    #[inline(always)]
    pub(crate) fn edge(&self, i: usize, j: usize) -> Lanes {
        if self.maps.is_empty() {
            return Lanes::ZERO;
        }
        let (a, b) = (&self.maps[i], &self.maps[j]);
        let sum = [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        times(&sum, self.positions[i] - self.positions[j]) * 0.5
    }
}

#[inline(always)]
pub(crate) fn times(map: &PatchMap, v: Lanes) -> Lanes {
    map[0] * v.0[0] + map[1] * v.0[1] + map[2] * v.0[2]
}

/// A rotation, as (x, y, z, w) of a unit quaternion.
pub(crate) type Turn = [f32; 4];

/// No rotation.
pub(crate) const STILL: Turn = [0.0, 0.0, 0.0, 1.0];

/// Newton steps of four matrices at a time.
const QUICK_STEPS: usize = 3;
/// Newton steps at most; rotations that change little take two.
const STEPS: usize = 30;
/// The square of a step after which the next one would be nothing.
const SHORT: f64 = 1e-6;

/// A matrix by its columns.
pub(crate) type Columns = [[f64; 3]; 3];

/// Three columns of which the fourth lane is of no use.
pub(crate) fn wide_columns(columns: &[Lanes; 3]) -> Columns {
    columns.map(|column| {
        let [x, y, z, _] = column.to_wide();
        [x, y, z]
    })
}

/// The rotation `a` after the rotation `b`.
pub(crate) fn after(a: Turn, b: Turn) -> Turn {
    normalized(product(a, b))
}

fn product<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>>(a: [T; 4], b: [T; 4]) -> [T; 4] {
    [
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    ]
}

fn normalized(q: Turn) -> Turn {
    let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
    q.map(|v| v / length)
}

fn normalized_wide(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / length)
}

/// The columns of a rotation.
fn columns<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>>([x, y, z, w]: [T; 4], one: T) -> [[T; 3]; 3] {
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz) = (x * x2, y * y2, z * z2);
    let (xy, xz, yz) = (x * y2, x * z2, y * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    [
        [one - yy - zz, xy + wz, xz - wy],
        [xy - wz, one - xx - zz, yz + wx],
        [xz + wy, yz - wx, one - xx - yy],
    ]
}

/// The columns of a map, turned.
#[inline(always)]
pub(crate) fn turned(q: Turn, map: &PatchMap) -> PatchMap {
    let r = columns(q, 1.0).map(|[x, y, z]| Lanes([x, y, z, 0.0]));
    map.map(|column| r[0] * column.0[0] + r[1] * column.0[1] + r[2] * column.0[2])
}

/// [`nearest_turn`] of four matrices by their columns, whose fourth lanes are of no use.
#[inline(always)]
pub(crate) fn nearest_turns(matrices: [&[Lanes; 3]; WIDTH]) -> [(Turn, f64); WIDTH] {
    /// Pivots below this leave something open, or nearly so.
    const LEAST: f32 = 1e-3;
    let raw: [[Lanes; 3]; 3] =
        std::array::from_fn(|c| std::array::from_fn(|k| Lanes(std::array::from_fn(|d| matrices[d][c].0[k]))));
    let squares = raw.as_flattened().iter().fold(Lanes::ZERO, |sum, v| sum + *v * *v);
    let size = Lanes(squares.0.map(f32::sqrt));
    let inverse = Lanes(size.0.map(|v| 1.0 / v));
    let a = raw.map(|column| column.map(|v| v * inverse));
    let one = Lanes::splat(1.0);
    let half = Lanes::splat(0.5);
    let mut q = [Lanes::ZERO, Lanes::ZERO, Lanes::ZERO, one];
    let mut good = [true; WIDTH];
    for round in 0..QUICK_STEPS {
        let r = columns(q, one);
        let b: [[Lanes; 3]; 3] = match round {
            0 => a,
            _ => std::array::from_fn(|c| std::array::from_fn(|k| sum_of_products(r[k], a[c]))),
        };
        let g = [b[1][2] - b[2][1], b[2][0] - b[0][2], b[0][1] - b[1][0]];
        let [yz, zx, xy] = [b[1][2] + b[2][1], b[2][0] + b[0][2], b[0][1] + b[1][0]].map(|v| Lanes::ZERO - v * half);
        let trace = b[0][0] + b[1][1] + b[2][2];
        let [d_x, d_y, d_z] = [trace - b[0][0], trace - b[1][1], trace - b[2][2]];
        let over_x = Lanes(d_x.0.map(|v| 1.0 / v));
        let (l_y, l_z) = (xy * over_x, zx * over_x);
        let d_y = d_y - l_y * xy;
        let over_y = Lanes(d_y.0.map(|v| 1.0 / v));
        let l_zy = (yz - l_z * xy) * over_y;
        let d_z = d_z - l_z * zx - l_zy * l_zy * d_y;
        let over_z = Lanes(d_z.0.map(|v| 1.0 / v));
        let y = g[1] - l_y * g[0];
        let z = (g[2] - l_z * g[0] - l_zy * y) * over_z;
        let y = y * over_y - l_zy * z;
        let x = g[0] * over_x - l_y * y - l_z * z;
        let long = x * x + y * y + z * z;
        let most = if round + 1 == QUICK_STEPS { SHORT as f32 } else { 1.0 };
        for d in 0..WIDTH {
            good[d] &= d_x.0[d] > LEAST && d_y.0[d] > LEAST && d_z.0[d] > LEAST && long.0[d] < most;
        }
        q = product(q, [x * half, y * half, z * half, one]);
        let squares = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
        let inverse = Lanes(squares.0.map(|v| 1.0 / v.sqrt()));
        q = q.map(|v| v * inverse);
    }
    let r = columns(q, one);
    let trace = (0..3).fold(Lanes::ZERO, |sum, c| sum + sum_of_products(r[c], raw[c]));
    std::array::from_fn(|d| match good[d] {
        true => (q.map(|v| v.0[d]), f64::from(trace.0[d])),
        false => nearest_turn(&wide_columns(matrices[d])),
    })
}

#[inline(always)]
fn sum_of_products(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The rotation R that makes tr(Rᵀ a) largest, and that trace. It is looked for from no rotation on; a matrix that does not
/// determine it keeps what it leaves open from there.
///
/// For R exp(ω) the trace is tr B + g·ω − ½ ωᵀ (tr(S) I − S) ω with B = Rᵀ a and S its symmetric part. Where that
/// matrix is positive the Newton step is taken, elsewhere one along g that cannot be too long.
pub(crate) fn nearest_turn(a: &Columns) -> (Turn, f64) {
    let size = a.iter().flatten().map(|v| v * v).sum::<f64>().sqrt();
    if !(size > 0.0 && size.is_finite()) {
        return (STILL, a[0][0] + a[1][1] + a[2][2]);
    }
    let a = a.map(|column| column.map(|v| v / size));
    let mut q = STILL.map(f64::from);
    for _ in 0..STEPS {
        let r = columns(q, 1.0);
        let b: Columns = std::array::from_fn(|c| std::array::from_fn(|k| dot(r[k], a[c])));
        let gradient = [b[1][2] - b[2][1], b[2][0] - b[0][2], b[0][1] - b[1][0]];
        let off = [b[1][2] + b[2][1], b[2][0] + b[0][2], b[0][1] + b[1][0]].map(|v| 0.5 * v);
        let trace = b[0][0] + b[1][1] + b[2][2];
        let diagonal = [trace - b[0][0], trace - b[1][1], trace - b[2][2]];
        let step = newton_step(diagonal, off, gradient)
            .filter(|step| dot(*step, *step) < 1.0)
            .unwrap_or_else(|| {
                let length = dot(gradient, gradient).sqrt();
                gradient.map(|v| v / (trace.abs() + length + 1e-9))
            });
        q = normalized_wide(product(q, [0.5 * step[0], 0.5 * step[1], 0.5 * step[2], 1.0]));
        if dot(step, step) < SHORT {
            break;
        }
    }
    let r = columns(q, 1.0);
    (q.map(|v| v as f32), size * (0..3).map(|c| dot(r[c], a[c])).sum::<f64>())
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Solves H ω = g for the symmetric H with `diagonal` and −`off` (yz, zx, xy); `None` unless H is clearly positive.
fn newton_step(diagonal: [f64; 3], off: [f64; 3], g: [f64; 3]) -> Option<[f64; 3]> {
    const LEAST: f64 = 1e-6;
    let [yz, zx, xy] = off.map(|v| -v);
    if diagonal[0] < LEAST {
        return None;
    }
    let (l_y, l_z) = (xy / diagonal[0], zx / diagonal[0]);
    let d_y = diagonal[1] - l_y * xy;
    if d_y < LEAST {
        return None;
    }
    let l_zy = (yz - l_z * xy) / d_y;
    let d_z = diagonal[2] - l_z * zx - l_zy * l_zy * d_y;
    if d_z < LEAST {
        return None;
    }
    let y = g[1] - l_y * g[0];
    let z = (g[2] - l_z * g[0] - l_zy * y) / d_z;
    let y = y / d_y - l_zy * z;
    Some([g[0] / diagonal[0] - l_y * y - l_z * z, y, z])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// r times a stretch whose axes are those of `along`.
    fn turned_stretch(r: &Columns, along: &Columns, stretch: [f64; 3]) -> Columns {
        let symmetric: Columns = std::array::from_fn(|c| {
            std::array::from_fn(|j| (0..3).map(|m| along[m][j] * along[m][c] * stretch[m]).sum())
        });
        symmetric.map(|c| std::array::from_fn(|j| (0..3).map(|m| r[m][j] * c[m]).sum()))
    }

    #[test]
    fn the_rotation_of_a_turned_stretch_is_found_one_by_one_and_four_at_a_time() {
        let angle = |k: usize, s: f64| libm::sin(k as f64 * s + s);
        // Turned a little, turned far, squeezed flat, inverted along the shortest axis.
        for (far, stretch) in [
            (0.2, [1.3, 0.6, 0.9]),
            (2.0, [1.3, 0.6, 0.9]),
            (1.0, [1.3, 0.9, 1e-3]),
            (0.7, [1.3, 0.9, -0.2]),
        ] {
            for k in 0..60 {
                let turns: [[f64; 4]; 4] = std::array::from_fn(|d| {
                    let k = 4 * k + d;
                    let [x, y, z] = [1.3, 2.1, 3.7].map(|s| far * angle(k, s));
                    normalized_wide([x, y, z, 1.2])
                });
                let matrices = turns.map(|q| {
                    let along = columns(normalized_wide([q[1], q[2], q[0], 1.0]), 1.0);
                    turned_stretch(&columns(q, 1.0), &along, stretch)
                });
                let lanes = matrices.map(|a| a.map(|[x, y, z]| Lanes([x as f32, y as f32, z as f32, 9.0])));
                let four = nearest_turns(lanes.each_ref());
                for ((q, a), four) in turns.iter().zip(&matrices).zip(four) {
                    for (found, trace) in [nearest_turn(a), four] {
                        let along: f64 = found.iter().zip(q).map(|(a, b)| f64::from(*a) * b).sum();
                        let sum: f64 = stretch.iter().sum();
                        assert!(along.abs() > 1.0 - 1e-5, "{found:?} against {q:?}, {stretch:?}");
                        assert!((trace - sum).abs() < 1e-4, "{trace} against {sum}");
                    }
                }
            }
        }
        assert_eq!(nearest_turn(&[[0.0; 3]; 3]).0, STILL);
        assert_eq!(nearest_turns([&[Lanes::ZERO; 3]; 4])[3].0, STILL);
    }
}
