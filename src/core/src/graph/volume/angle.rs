//! The angle of a direction in the upper half plane.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Arguments of this size and its reciprocal have a quotient and need no care.
const MODERATE: f64 = 1e150;
/// Where the arc tangent changes from one of its five forms to the next.
const STEPS: [f64; 4] = [0.4375, 0.6875, 1.1875, 2.4375];
/// For each form (a, b, c, d): the arc tangent of q is that of (a q − b) / (c + d q) …
const FRACTIONS: [[f64; 4]; 5] = [
    [1.0, 0.0, 1.0, 0.0],
    [2.0, 1.0, 2.0, 1.0],
    [1.0, 1.0, 1.0, 1.0],
    [1.0, 1.5, 1.0, 1.5],
    [0.0, 1.0, 0.0, 1.0],
];
/// … and of 0, ½, 1, 1½ or ∞, in two parts.
const SHIFTS: [[f64; 2]; 5] = [
    [0.0, 0.0],
    [4.636_476_090_008_061e-1, 2.269_877_745_296_168_7e-17],
    [FRAC_PI_4, 3.061_616_997_868_383e-17],
    [9.827_937_232_473_29e-1, 1.390_331_103_123_099_8e-17],
    [FRAC_PI_2, 6.123_233_995_736_766e-17],
];
const EVEN: [f64; 6] = [
    3.333_333_333_333_293e-1,
    1.428_571_427_250_346_6e-1,
    9.090_887_133_436_507e-2,
    6.661_073_137_387_531e-2,
    4.976_877_994_615_932_4e-2,
    1.628_582_011_536_578_2e-2,
];
const ODD: [f64; 5] = [
    -1.999_999_999_987_648_3e-1,
    -1.111_111_040_546_235_6e-1,
    -7.691_876_205_044_83e-2,
    -5.833_570_133_790_573_5e-2,
    -3.653_157_274_421_691_6e-2,
];
const PI_LOW: f64 = 1.224_646_799_147_353_2e-16;

/// The angle of (`x`, `y`) for `y` above 0: bit-identical to `libm::atan2`, by the same steps without their branches,
/// which angles of a mesh take at random.
#[inline]
pub(in crate::graph) fn upper_angle(y: f64, x: f64) -> f64 {
    let is_moderate = |v: f64| (1.0 / MODERATE..MODERATE).contains(&v);
    let q = (y / x).abs();
    if !(is_moderate(y) && is_moderate(x.abs()) && (1e-8..1e18).contains(&q)) {
        return libm::atan2(y, x);
    }
    let form: usize = STEPS.iter().map(|&step| usize::from(q >= step)).sum();
    let ([a, b, c, d], [high, low]) = (FRACTIONS[form], SHIFTS[form]);
    let r = (a * q - b) / (c + d * q);
    let z = r * r;
    let w = z * z;
    let even = z * (EVEN[0] + w * (EVEN[1] + w * (EVEN[2] + w * (EVEN[3] + w * (EVEN[4] + w * EVEN[5])))));
    let odd = w * (ODD[0] + w * (ODD[1] + w * (ODD[2] + w * (ODD[3] + w * ODD[4]))));
    let angle = high - (r * (even + odd) - low - r);
    if x < 0.0 { PI - (angle - PI_LOW) } else { angle }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_libm_to_the_bit() {
        let mut state = 5u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let ask = |y: f64, x: f64| {
            let (own, known) = (upper_angle(y, x), libm::atan2(y, x));
            assert_eq!(own.to_bits(), known.to_bits(), "{y:e}, {x:e}: {own:e}, {known:e}");
        };
        let edges = STEPS.iter().flat_map(|s| [s.next_down(), *s, s.next_up()]);
        let special = [
            1.0,
            0.0,
            -0.0,
            1e-300,
            1e300,
            5e-324,
            f64::INFINITY,
            f64::NAN,
            1e-8,
            1e18,
            1e-20,
        ];
        let values: Vec<f64> = edges.chain(special).collect();
        for &y in values.iter().filter(|&&y| y > 0.0) {
            for &x in &values {
                ask(y, x);
                ask(y, -x);
            }
        }
        for _ in 0..200_000 {
            ask(next() + 1e-12, next() - 0.5);
            let scale = libm::exp2(40.0 * (next() - 0.5));
            ask(next() * scale + 1e-300, next() - 0.5);
        }
    }
}
