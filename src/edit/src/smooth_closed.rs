//! Closed parts that a smoothing would shrink as a whole.
//!
//! On a coarse part the longest waves there are, those of its own size, are short in edges, so that smoothing takes them for noise
//! and the part goes towards a point: a cone of 16 sides loses two thirds of its volume in 20 iterations. What an iteration has done
//! to such a part as a whole, the affine map that comes closest to it, is taken back. Its volume is given back at the end. A part that
//! would lose its shape nevertheless stays as it is then.

use glam::{DMat3, DVec3};

/// Waves below this frequency pass, in units of the weighted Laplacian, whose frequencies go from 0 to 2.
pub(super) const PASSED: f64 = 0.05;

/// Steps of the power iteration that finds the frequency of a part's own size.
const STEPS: usize = 32;

/// How far the second moments of a part grow at most, relative to what is still like the part as it was.
const MOST_SPREAD: f64 = 1.1;

/// A part of which all points move, with the points as places among those that move.
pub(super) struct WholePart {
    points: Vec<u32>,
    /// Where they were, relative to their mean.
    before: Vec<DVec3>,
    /// The inverse of the second moments of these.
    inverse: DMat3,
}

impl WholePart {
    /// The part of some points, were they all of it and would smoothing shrink it. `neighbours` are places among those that move with
    /// weights, `None` for one that does not.
    pub fn find<N: Iterator<Item = (Option<u32>, f64)>>(
        points: &[u32],
        at: &[DVec3],
        neighbours: impl Fn(u32) -> N,
    ) -> Option<Self> {
        let here = |p: u32| at[p as usize];
        let mean = points.iter().map(|&p| here(p)).sum::<DVec3>() / points.len() as f64;
        let (mut spread, mut edges) = (DMat3::ZERO, DMat3::ZERO);
        for &p in points {
            spread += outer(here(p) - mean, here(p) - mean);
            for (q, weight) in neighbours(p) {
                let edge = here(p) - here(q?);
                edges += outer(edge, edge) * (0.5 * weight);
            }
        }
        let inverse = spread.inverse();
        // The part's extents are nearly waves of their own; the shortest of them is the one that goes first.
        let map = inverse * edges;
        let mut axis = DVec3::new(1.0, 0.9, 0.8);
        for _ in 0..STEPS {
            axis = (map * axis).try_normalize()?;
        }
        (inverse.is_finite() && (map * axis).length() > PASSED).then(|| Self {
            before: points.iter().map(|&p| here(p) - mean).collect(),
            points: points.to_vec(),
            inverse,
        })
    }

    /// Takes back what an iteration that began at `last` has done to the part as a whole, or all of it where too little is left of the
    /// part's shape.
    pub fn restore_extents(&self, last: &[DVec3], at: &mut [DVec3]) {
        let mean = self.mean(at);
        let both = self.points.iter().zip(&self.before);
        let covariance = both.fold(DMat3::ZERO, |sum, (&p, was)| sum + outer(at[p as usize] - mean, *was));
        let back = (covariance * self.inverse).inverse();
        let restored = |p: u32| back * (at[p as usize] - mean);
        let spread = (self.points.iter()).fold(DMat3::ZERO, |sum, &p| sum + outer(restored(p), restored(p)));
        let grown = spread * self.inverse;
        let is_like = (grown.x_axis.x + grown.y_axis.y + grown.z_axis.z) / 3.0 <= MOST_SPREAD;
        let places: Vec<DVec3> = match is_like && back.determinant() > 0.0 {
            true => self.points.iter().map(|&p| mean + restored(p)).collect(),
            false => self.points.iter().map(|&p| last[p as usize]).collect(),
        };
        self.points
            .iter()
            .zip(places)
            .for_each(|(&p, place)| at[p as usize] = place);
    }

    fn mean(&self, at: &[DVec3]) -> DVec3 {
        self.points.iter().map(|&p| at[p as usize]).sum::<DVec3>() / self.points.len() as f64
    }

    /// Scales the part about its middle, so that its volume is so many times what it is.
    pub fn scale_volume(&self, times: f64, at: &mut [DVec3]) {
        let mean = self.mean(at);
        let factor = libm::cbrt(times);
        (self.points.iter()).for_each(|&p| at[p as usize] = mean + (at[p as usize] - mean) * factor);
    }

    /// Its points, as places among those that move.
    pub fn points(&self) -> &[u32] {
        &self.points
    }
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
