//! Frames of all nodes many times a second: about one axis by three matrices and a polynomial, else as the first pass blends them.

use crate::deform::first_pass::blend::{OneAxisBlend, PoseBlend};
use crate::solver::{MapColumns, prefetch};
use glam::{DMat3, DVec3, Mat3};
use std::f64::consts::{FRAC_2_PI, FRAC_PI_2};

/// π/2 less its nearest double.
const FRAC_PI_2_REST: f64 = 6.123_233_995_736_766e-17;

/// Angles beyond this many radians, which no hand turns, are left to the library.
const FARTHEST: f64 = 1e6;

/// Added to a double and taken off again, leaves the nearest whole number.
const ROUNDING: f64 = 6_755_399_441_055_744.0;

/// The frames of a pose.
pub(in crate::deform) struct QuickFrames<'a> {
    blend: PoseBlend<'a>,
    one_axis: Option<OneAxisFrames<'a>>,
}

/// Frames about one axis: a base, and what sine and 1 − cosine of an angle add to it (Rodrigues).
struct OneAxisFrames<'a> {
    blend: OneAxisBlend<'a>,
    matrices: [MapColumns; 3],
}

impl<'a> QuickFrames<'a> {
    pub fn new(blend: PoseBlend<'a>) -> Self {
        let one_axis = blend.one_axis().map(|blend| {
            let DVec3 { x, y, z } = blend.axis;
            let across = DMat3::from_cols_array(&[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]);
            let base = DMat3::from_quat(blend.base);
            let matrices = [base, base * across, base * across * across];
            OneAxisFrames {
                blend,
                matrices: matrices.map(|m| columns(&m.as_mat3())),
            }
        });
        Self { blend, one_axis }
    }

    /// The frame of a node; `scratch` is memory for the terms.
    #[inline]
    pub fn at(&self, node: usize, scratch: &mut Vec<(usize, f64)>) -> MapColumns {
        match &self.one_axis {
            Some(frames) => frames.at(node),
            None => self.blended_at(node, scratch),
        }
    }

    /// Asks memory for what the frame of a node is made from.
    #[inline]
    pub fn prefetch(&self, node: usize) {
        if let Some(OneAxisFrames { blend, .. }) = &self.one_axis {
            prefetch(blend.component, node);
            blend.terms.iter().for_each(|(field, _)| prefetch(field, node));
        }
    }

    fn blended_at(&self, node: usize, scratch: &mut Vec<(usize, f64)>) -> MapColumns {
        let map = self.blend.map(node, scratch);
        columns(&map.map_or(Mat3::IDENTITY, |map| map.as_mat3()))
    }
}

impl OneAxisFrames<'_> {
    #[inline]
    fn at(&self, node: usize) -> MapColumns {
        let OneAxisBlend {
            terms,
            covered,
            component,
            ..
        } = &self.blend;
        if !covered[component[node] as usize] {
            return columns(&Mat3::IDENTITY);
        }
        let mut angle = 0.0;
        for (field, whole) in terms {
            angle += f64::from(field[node]).max(0.0) * whole;
        }
        let [base, by_sine, by_rest] = &self.matrices;
        if angle == 0.0 {
            return *base;
        }
        let (sine, cosine) = sin_cos(angle);
        let (sine, rest) = (sine as f32, (1.0 - cosine) as f32);
        std::array::from_fn(|k| {
            let column = |c: usize| base[k][c] + by_sine[k][c] * sine + by_rest[k][c] * rest;
            std::array::from_fn(column)
        })
    }
}

fn columns(map: &Mat3) -> MapColumns {
    map.to_cols_array_2d().map(|[x, y, z]| [x, y, z, 0.0])
}

/// Sine and cosine. On an eighth of a turn either side of 0 the Taylor series up to x¹³ and x¹² are off by less than the term
/// left out: (π/4)¹⁵ / 15! < 3e-14 and (π/4)¹⁴ / 14! < 4e-13; taking quarter turns off loses 1e-16 of the angle.
#[inline]
fn sin_cos(x: f64) -> (f64, f64) {
    if x.is_nan() || x.abs() > FARTHEST {
        return libm::sincos(x);
    }
    let quarters = (x * FRAC_2_PI + ROUNDING) - ROUNDING;
    let r = (x - quarters * FRAC_PI_2) - quarters * FRAC_PI_2_REST;
    let s = r * r;
    let sin = 1.0 / 6_227_020_800.0;
    let sin = -1.0 / 39_916_800.0 + s * sin;
    let sin = 1.0 / 362_880.0 + s * sin;
    let sin = -1.0 / 5_040.0 + s * sin;
    let sin = 1.0 / 120.0 + s * sin;
    let sin = r + r * s * (-1.0 / 6.0 + s * sin);
    let cos = 1.0 / 479_001_600.0;
    let cos = -1.0 / 3_628_800.0 + s * cos;
    let cos = 1.0 / 40_320.0 + s * cos;
    let cos = -1.0 / 720.0 + s * cos;
    let cos = 1.0 / 24.0 + s * cos;
    let cos = 1.0 + s * (-0.5 + s * cos);
    match quarters as i64 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_those_of_the_library() {
        let mut worst = 0.0f64;
        for k in -400_000..400_000 {
            let x = f64::from(k) * 1.7e-4;
            let (quick, exact) = (sin_cos(x), libm::sincos(x));
            worst = worst.max((quick.0 - exact.0).abs()).max((quick.1 - exact.1).abs());
        }
        assert!(worst < 1e-12, "{worst}");
        for odd in [0.0, -0.0, 1e-200, 1e5 + 0.3, -9e5, 1e9, f64::INFINITY, f64::NAN] {
            let (quick, exact) = (sin_cos(odd), libm::sincos(odd));
            let near = (quick.0 - exact.0).abs() < 1e-10 && (quick.1 - exact.1).abs() < 1e-10;
            assert!(
                near || exact.0.is_nan() && quick.0.is_nan(),
                "{odd}: {quick:?} against {exact:?}"
            );
        }
    }
}
