//! Splats as the attributes of a glTF have them.

use super::cloud::{SplatChange, SplatLook, SplatShape, Splats, coefficients_of};
use crate::Format;
use bytes::Bytes;
use glam::DVec3;

/// Numbers of splats, one row of each for every splat.
#[derive(Debug, Clone, PartialEq)]
pub(in super::super) struct SplatAttributes {
    /// Quaternions x, y, z, w.
    pub turns: Vec<f32>,
    /// Standard deviations along the axes.
    pub scales: Vec<f32>,
    /// For each coefficient beyond degree 0 its three colours: 0, 3, 8 or 15 lists.
    pub harmonics: Vec<Vec<f32>>,
}

impl SplatAttributes {
    /// How many splats have numbers that are those of no ellipsoid.
    pub(in super::super) fn unsound(&self) -> usize {
        Splats::of_attributes(vec![DVec3::ZERO; self.scales.len() / 3], self).unsound()
    }
}

impl Splats {
    /// Splats of attributes, without looks.
    pub(in super::super) fn of_attributes(centers: Vec<DVec3>, numbers: &SplatAttributes) -> Self {
        let count = centers.len();
        let degree = (0..=3).find(|&d| coefficients_of(d) == 3 * numbers.harmonics.len());
        let degree = degree.unwrap_or(0);
        let width = coefficients_of(degree);
        let mut splats = Self::with_room(Format::GLB, count, degree, Bytes::new());
        for row in 0..count {
            let scale = |axis: usize| libm::logf(numbers.scales[3 * row + axis]);
            let turn = [0, 1, 2, 3].map(|k| numbers.turns[4 * row + k]);
            splats
                .shapes
                .push(SplatShape::new(turn, [scale(0), scale(1), scale(2)]));
            splats.looks.push(SplatLook {
                colour: [0.0; 3],
                opacity: 0.0,
            });
            for (k, values) in numbers.harmonics.iter().take(width / 3).enumerate() {
                for colour in 0..3 {
                    splats.harmonics[row * width + colour * (width / 3) + k] = values[3 * row + colour];
                }
            }
        }
        splats.centers = centers;
        splats
    }

    /// Their numbers as they are now; of those that have not moved, and of those that are none, the stored ones.
    pub(in super::super) fn attributes(&self, stored: &SplatAttributes) -> SplatAttributes {
        let mut now = stored.clone();
        let width = self.coefficients();
        for row in (0..self.len()).filter(|&row| self.changes[row] > SplatChange::None) {
            let shape = &self.shapes[row];
            if shape.is_sound() {
                now.turns[4 * row..4 * row + 4].copy_from_slice(&shape.turn);
                for (scale, log_scale) in now.scales[3 * row..].iter_mut().zip(shape.log_scale) {
                    *scale = libm::expf(log_scale);
                }
            }
            for (k, values) in now.harmonics.iter_mut().take(width / 3).enumerate() {
                for colour in 0..3 {
                    values[3 * row + colour] = self.harmonics[row * width + colour * (width / 3) + k];
                }
            }
        }
        now
    }
}
