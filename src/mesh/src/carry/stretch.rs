//! How space around a point has stretched: the gradient of the motion, for passengers that have an extent of their own.
//!
//! A triangle says how space has stretched in its plane, and of what is across it only a guess. So the gradient at a point is the
//! one that fits the planes around it best: where they face all ways, as around a point inside, it is that of the whole motion;
//! on a flat surface the guess remains across it, the root of the growth of area.

use crate::carry::motion::{Averaged, CarriedFrame, CarrySurface, SurfaceMotion, weighted_gradient};
use crate::rotation::outer_product;
use glam::{DMat3, DVec3};
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// What the guess across a triangle weighs beside what its plane says.
const ACROSS: f64 = 0.1;
/// Where rotations agree less than the first, a mean of gradients shrinks what it turns; below the second the motion counts as a
/// similarity.
const CONTRADICTION: [f64; 2] = [0.9, 0.7];

/// Where a point of rest space has been carried, with the gradient of the motion there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CarriedSpace {
    /// Where the point is now, and the similarity around it.
    pub frame: CarriedFrame,
    /// The gradient: a short rest offset `d` from the point is now `gradient * d`. The identity where nothing has moved.
    pub gradient: DMat3,
}

impl CarriedSpace {
    /// A place that has not moved.
    pub fn resting(position: DVec3) -> Self {
        Self {
            frame: CarriedFrame::resting(position),
            gradient: DMat3::IDENTITY,
        }
    }
}

/// How every sample of a [`CarrySurface`] has stretched in one deformed shape.
#[derive(Debug, Clone)]
pub struct SurfaceStretch {
    samples: Vec<SampleStretch>,
}

/// The sums of a least-squares fit: its gradient is `moved` divided by `rest`.
#[derive(Debug, Clone, Copy)]
struct SampleStretch {
    moved: DMat3,
    rest: DMat3,
}

impl Averaged for SampleStretch {
    const NONE: Self = Self {
        moved: DMat3::ZERO,
        rest: DMat3::ZERO,
    };

    #[inline]
    fn add(&mut self, weight: f64, other: &Self) {
        self.moved += other.moved * weight;
        self.rest += other.rest * weight;
    }

    fn divided_by(self, weight: f64) -> Self {
        let part = 1.0 / weight;
        Self {
            moved: self.moved * part,
            rest: self.rest * part,
        }
    }
}

impl SurfaceStretch {
    /// Measures how `surface` has stretched in `motion`.
    pub(super) fn of(surface: &CarrySurface, motion: &SurfaceMotion, pool: &Pool) -> Self {
        let of_triangle = |t: u32| {
            let triangle = surface.triangles[t as usize];
            let rest = surface.corners(t);
            let now = triangle.map(|v| surface.rest[v as usize] + motion.displacement(v as usize));
            let gradient = weighted_gradient(rest, now)?;
            let doubled = surface.doubled_normal(t);
            let unit = doubled.try_normalize()?;
            let area = 0.5 * doubled.length();
            let plane = DMat3::IDENTITY - outer_product(unit, unit) * (1.0 - ACROSS);
            let own = SampleStretch {
                moved: gradient * plane,
                rest: plane * area,
            };
            Some((own, area))
        };
        let of_triangles: Vec<Option<(SampleStretch, f64)>> = pool.install(|| {
            let triangles = (0..surface.triangles.len() as u32).into_par_iter().with_min_len(256);
            triangles.map(of_triangle).collect()
        });
        let mut sums = vec![(SampleStretch::NONE, 0.0f64); surface.vertices()];
        for (triangle, own) in surface.triangles.iter().zip(&of_triangles) {
            let Some((own, area)) = own else {
                continue;
            };
            for &v in triangle {
                sums[v as usize].0.add(1.0, own);
                sums[v as usize].1 += area;
            }
        }
        let mean = |(sum, area): (SampleStretch, f64)| match area > 0.0 {
            true => sum.divided_by(area),
            // What has no area says nothing, and has its say as part of what is around it.
            false => SampleStretch::NONE,
        };
        let mut samples: Vec<SampleStretch> = sums.into_iter().map(mean).collect();
        pool.install(|| surface.add_clusters(&mut samples));
        Self { samples }
    }

    /// The sums of the fit of a sample: the second one does not depend on the shape.
    pub(super) fn sums(&self, sample: usize) -> (DMat3, DMat3) {
        let SampleStretch { moved, rest } = self.samples[sample];
        (moved, rest)
    }

    /// The gradient at `point`, which follows `samples` and has been carried to `frame`.
    pub(super) fn around<I: Iterator<Item = (u32, f64)>>(
        &self,
        motion: &SurfaceMotion,
        frame: CarriedFrame,
        point: DVec3,
        samples: impl Fn() -> I,
    ) -> CarriedSpace {
        if frame == CarriedFrame::resting(point) {
            return CarriedSpace::resting(point);
        }
        let turn = DMat3::from_quat(frame.rotation);
        let similar = turn * frame.scale;
        let mut sum = SampleStretch::NONE;
        samples().for_each(|(sample, weight)| sum.add(weight, &self.samples[sample as usize]));
        let fitted = sum.moved * sum.rest.inverse();
        let [clear, vague] = CONTRADICTION;
        let doubt = ((clear - motion.agreement(samples())) / (clear - vague)).clamp(0.0, 1.0);
        let mixed = fitted * (1.0 - doubt) + similar * doubt;
        let gradient = if mixed.is_finite() { mixed } else { similar };
        CarriedSpace { frame, gradient }
    }
}
