//! How the samples of a surface have moved in one shape, packed: what points gather four numbers at a time.

use crate::carry::motion::{CarrySurface, SurfaceMotion};
use crate::carry::stretch::SurfaceStretch;
use glam::{DVec3, Mat3A, Quat, Vec4};
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Where a mean of quaternions is shorter than the first they contradict each other, and below the second the rotation of the whole
/// surface says as much as they do: the lengths at which the mean of rotations has those of
/// [`CarriedPoints::carried_by`](super::CarriedPoints::carried_by).
const CONTRADICTION: [f32; 2] = [0.86, 0.78];
/// The same for the mean of gradients.
const CONTRADICTION_OF_STRETCH: [f32; 2] = [0.95, 0.86];
/// Above the square of the larger of both nothing is looked at.
pub(super) const CLEAR: f32 = 0.95 * 0.95;

/// A sample that a point follows.
#[derive(Debug, Clone, Copy)]
pub(super) struct PackedSample {
    pub number: u32,
    pub weight: f32,
}

/// How the samples of a surface have moved in one shape, packed.
#[derive(Debug)]
pub struct PackedMotion {
    samples: Vec<SampleRecord>,
    log_scales: Vec<f32>,
    whole: Vec4,
}

/// The motion of a sample: one line of a cache.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct SampleRecord {
    /// The columns of the sums of the fit of a gradient, and in w a number of the displacement each.
    pub columns: [Vec4; 3],
    /// A unit quaternion, on the side of that of the whole surface.
    pub turn: Vec4,
}

/// The mean motion of what a point follows.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeanMotion {
    pub sums: SampleRecord,
    pub log_scale: f32,
}

/// The mean rotation of what a point follows, and the gradient.
pub(super) struct AgreedMotion {
    pub turn: Vec4,
    pub gradient: Mat3A,
}

impl PackedMotion {
    /// Packs how `surface` has become `current`, which has one position per vertex of the surface.
    ///
    /// # Panics
    /// When `current` is shorter than the surface has vertices.
    pub fn between(surface: &CarrySurface, current: &[DVec3], pool: &Pool) -> Self {
        let motion = SurfaceMotion::between(surface, current, pool);
        let stretch = SurfaceStretch::of(surface, &motion, pool);
        let whole = Vec4::from_array(motion.whole().to_array().map(|v| v as f32));
        let pack = |sample: usize| {
            let (displacement, turn, log_scale) = motion.of_sample(sample);
            let moved = stretch.sums(sample).0;
            let turn = Vec4::from_array(turn.to_array().map(|v| v as f32));
            let record = SampleRecord {
                columns: [
                    moved.x_axis.extend(displacement.x).as_vec4(),
                    moved.y_axis.extend(displacement.y).as_vec4(),
                    moved.z_axis.extend(displacement.z).as_vec4(),
                ],
                turn: if turn.dot(whole) < 0.0 { -turn } else { turn },
            };
            (record, log_scale as f32)
        };
        let (samples, log_scales) = pool.install(|| {
            let numbers = (0..surface.samples()).into_par_iter().with_min_len(64);
            numbers.map(pack).unzip()
        });
        Self {
            samples,
            log_scales,
            whole,
        }
    }

    /// The mean of samples, as if their quaternions were on one side.
    #[inline]
    pub(super) fn mean(&self, samples: &[PackedSample]) -> MeanMotion {
        let mut mean = MeanMotion {
            sums: SampleRecord {
                columns: [Vec4::ZERO; 3],
                turn: Vec4::ZERO,
            },
            log_scale: 0.0,
        };
        let sums = &mut mean.sums;
        for &PackedSample { number, weight } in samples {
            let sample = &self.samples[number as usize];
            sums.columns[0] += sample.columns[0] * weight;
            sums.columns[1] += sample.columns[1] * weight;
            sums.columns[2] += sample.columns[2] * weight;
            sums.turn += sample.turn * weight;
            mean.log_scale += self.log_scales[number as usize] * weight;
        }
        mean
    }

    /// The same where rotations are on two sides or contradict each other, or sums determine no gradient: which is rare. `inverse`
    /// makes a gradient of the sums.
    #[cold]
    pub(super) fn agreed(&self, samples: &[PackedSample], mean: &MeanMotion, inverse: Mat3A) -> AgreedMotion {
        let Some(one) = samples.first() else {
            return AgreedMotion {
                turn: Vec4::W,
                gradient: Mat3A::IDENTITY,
            };
        };
        let side = self.samples[one.number as usize].turn;
        let mut turn = Vec4::ZERO;
        for &PackedSample { number, weight } in samples {
            let own = self.samples[number as usize].turn;
            turn += own * if own.dot(side) < 0.0 { -weight } else { weight };
        }
        let [x, y, z] = mean.sums.columns.map(|column| column.truncate().into());
        let gradient = Mat3A::from_cols(x, y, z) * inverse;
        let agreement = turn.length();
        let doubt = |[clear, vague]: [f32; 2]| ((clear - agreement) / (clear - vague)).clamp(0.0, 1.0);
        let whole = if self.whole.dot(turn) < 0.0 {
            -self.whole
        } else {
            self.whole
        };
        turn += whole * (0.5 * doubt(CONTRADICTION));
        let unsure = doubt(CONTRADICTION_OF_STRETCH);
        let similar = Mat3A::from_quat(Quat::from_vec4(turn).normalize()) * libm::expf(mean.log_scale);
        let mixed = gradient * (1.0 - unsure) + similar * unsure;
        AgreedMotion {
            turn,
            gradient: if mixed.is_finite() { mixed } else { similar },
        }
    }
}
