//! Spherical harmonics of colours, turned.
//!
//! A colour by direction `f` becomes `f(R⁻¹ d)`. Of each degree it is known by its values in as many directions as it has
//! coefficients, so turning is: take the values in the directions turned back, and find the coefficients that give them.

use glam::{DQuat, DVec3};

/// Directions in which the harmonics of degree 2 and 3 differ well (condition 1.8 and 2.5); of degree 1 the axes.
const DIRECTIONS_2: [[f64; 3]; 5] = [
    [-1.0, 3.0, 1.0],
    [0.0, -1.0, -3.0],
    [3.0, -1.0, -2.0],
    [-1.0, -2.0, 3.0],
    [1.0, -1.0, 1.0],
];
const DIRECTIONS_3: [[f64; 3]; 7] = [
    [2.0, 0.0, 2.0],
    [-2.0, 0.0, 2.0],
    [-2.0, 1.0, 0.0],
    [-1.0, 1.0, -1.0],
    [0.0, 2.0, 0.0],
    [0.0, 0.0, -1.0],
    [-2.0, 0.0, 0.0],
];

/// The harmonics of degree 1 in a direction, as 3DGS orders and signs them (Kerbl et al. 2023).
fn degree_1(d: DVec3) -> [f64; 3] {
    const C: f64 = 0.488_602_511_902_919_9;
    [-C * d.y, C * d.z, -C * d.x]
}

fn degree_2(d: DVec3) -> [f64; 5] {
    const C: f64 = 1.092_548_430_592_079_2;
    let DVec3 { x, y, z } = d;
    [
        C * x * y,
        -C * y * z,
        0.315_391_565_252_520_05 * (2.0 * z * z - x * x - y * y),
        -C * x * z,
        0.5 * C * (x * x - y * y),
    ]
}

fn degree_3(d: DVec3) -> [f64; 7] {
    const C: [f64; 5] = [
        0.590_043_589_926_643_5,
        2.890_611_442_640_554,
        0.457_045_799_464_465_8,
        0.373_176_332_590_115_4,
        1.445_305_721_320_277,
    ];
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        -C[0] * y * (3.0 * xx - yy),
        C[1] * x * y * z,
        -C[2] * y * (4.0 * zz - xx - yy),
        C[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -C[2] * x * (4.0 * zz - xx - yy),
        C[4] * z * (xx - yy),
        -C[0] * x * (xx - 3.0 * yy),
    ]
}

/// Turns coefficients of degree 1 to 3.
pub(super) struct HarmonicTurn {
    first: DegreeTurn<3>,
    second: DegreeTurn<5>,
    third: DegreeTurn<7>,
}

/// Turns the coefficients of one degree.
struct DegreeTurn<const N: usize> {
    directions: [DVec3; N],
    /// Makes coefficients of the values in those directions.
    from_values: [[f64; N]; N],
    harmonics: fn(DVec3) -> [f64; N],
}

impl HarmonicTurn {
    pub fn new() -> Self {
        let axes = DVec3::AXES.map(|axis| axis.to_array());
        Self {
            first: DegreeTurn::of(axes, degree_1),
            second: DegreeTurn::of(DIRECTIONS_2, degree_2),
            third: DegreeTurn::of(DIRECTIONS_3, degree_3),
        }
    }

    /// Turns the coefficients up to `degree`, those of degree 0 left out: all of red, then green, then blue.
    pub fn turn(&self, degree: u8, turn: DQuat, coefficients: &mut [f32]) {
        let back = turn.conjugate();
        let first = self.first.matrix(back);
        let second = (degree > 1).then(|| self.second.matrix(back));
        let third = (degree > 2).then(|| self.third.matrix(back));
        for colour in coefficients.chunks_exact_mut(coefficients.len() / 3) {
            apply(&first, &mut colour[0..3]);
            if let Some(second) = &second {
                apply(second, &mut colour[3..8]);
            }
            if let Some(third) = &third {
                apply(third, &mut colour[8..15]);
            }
        }
    }
}

impl<const N: usize> DegreeTurn<N> {
    fn of(directions: [[f64; 3]; N], harmonics: fn(DVec3) -> [f64; N]) -> Self {
        let directions = directions.map(|d| DVec3::from_array(d).normalize());
        Self {
            directions,
            from_values: inverse(directions.map(harmonics)),
            harmonics,
        }
    }

    /// What turns coefficients, where `back` turns a direction back.
    fn matrix(&self, back: DQuat) -> [[f64; N]; N] {
        let values = self.directions.map(|d| (self.harmonics)(back * d));
        let mut product = [[0.0; N]; N];
        for (row, from) in product.iter_mut().zip(&self.from_values) {
            for (from, values) in from.iter().zip(&values) {
                for (sum, value) in row.iter_mut().zip(values) {
                    *sum += from * value;
                }
            }
        }
        product
    }
}

fn apply<const N: usize>(matrix: &[[f64; N]; N], coefficients: &mut [f32]) {
    let mut old = [0.0; N];
    for (old, new) in old.iter_mut().zip(&*coefficients) {
        *old = f64::from(*new);
    }
    for (new, row) in coefficients.iter_mut().zip(matrix) {
        *new = row.iter().zip(&old).map(|(a, b)| a * b).sum::<f64>() as f32;
    }
}

/// The inverse of a matrix that has one, by elimination with the largest pivot of each column.
fn inverse<const N: usize>(mut matrix: [[f64; N]; N]) -> [[f64; N]; N] {
    let mut result = [[0.0; N]; N];
    for (i, row) in result.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for column in 0..N {
        let mut pivot = column;
        for row in column + 1..N {
            if matrix[row][column].abs() > matrix[pivot][column].abs() {
                pivot = row;
            }
        }
        matrix.swap(column, pivot);
        result.swap(column, pivot);
        let part = 1.0 / matrix[column][column];
        matrix[column].iter_mut().for_each(|v| *v *= part);
        result[column].iter_mut().for_each(|v| *v *= part);
        for row in 0..N {
            if row == column {
                continue;
            }
            let factor = matrix[row][column];
            for k in 0..N {
                matrix[row][k] -= factor * matrix[column][k];
                result[row][k] -= factor * result[column][k];
            }
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_colour_is_seen_from_turned_sides_as_before() {
        let mut state = 7u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / (1u64 << 23) as f64 - 1.0
        };
        let turns = HarmonicTurn::new();
        let seen = |coefficients: &[f32], d: DVec3| {
            let values = degree_1(d).into_iter().chain(degree_2(d)).chain(degree_3(d));
            values.zip(coefficients).map(|(y, &c)| y * f64::from(c)).sum::<f64>()
        };
        for _ in 0..50 {
            let turn = DQuat::from_xyzw(next(), next(), next(), next()).normalize();
            let old: Vec<f32> = (0..45).map(|_| next() as f32).collect();
            let mut new = old.clone();
            turns.turn(3, turn, &mut new);
            let side = DVec3::new(next(), next(), next()).normalize();
            for colour in 0..3 {
                let own = colour * 15..(colour + 1) * 15;
                let difference = seen(&new[own.clone()], turn * side) - seen(&old[own], side);
                assert!(difference.abs() < 2e-6, "{difference}");
            }
        }
    }
}
