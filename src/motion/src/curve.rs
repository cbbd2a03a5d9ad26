//! A value over time, between keys.

use glam::{DQuat, DVec3};
pub use pliant_asset::ChannelInterpolation as Interpolation;
use std::ops::{Add, Mul};
use std::sync::Arc;

/// What a curve can run through.
pub trait CurveValue: Copy + Add<Output = Self> + Mul<f64, Output = Self> {
    /// The value a share `t` (0 to 1) of the way from `self` to `end`.
    fn between(self, end: Self, t: f64) -> Self;

    /// The value of the spline from `self` to `end` with these tangents, a share `t` of the way through `span` seconds.
    fn along_spline(self, leaving: Self, arriving: Self, end: Self, at: SplinePlace) -> Self {
        let [a, b, c, d] = at.hermite();
        self * a + leaving * b + arriving * c + end * d
    }
}

/// A place on a spline between two keys.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SplinePlace {
    /// Share of the way, 0 to 1.
    pub t: f64,
    /// Seconds from key to key.
    pub span: f64,
}

impl SplinePlace {
    /// How much the first value, its tangent, the second's tangent and the second value count.
    fn hermite(self) -> [f64; 4] {
        let Self { t, span } = self;
        let (t2, t3) = (t * t, t * t * t);
        [
            2.0 * t3 - 3.0 * t2 + 1.0,
            span * (t3 - 2.0 * t2 + t),
            span * (t3 - t2),
            3.0 * t2 - 2.0 * t3,
        ]
    }
}

impl CurveValue for f64 {
    fn between(self, end: Self, t: f64) -> Self {
        self * (1.0 - t) + end * t
    }
}

impl CurveValue for DVec3 {
    fn between(self, end: Self, t: f64) -> Self {
        self.lerp(end, t)
    }
}

impl CurveValue for DQuat {
    fn between(self, end: Self, t: f64) -> Self {
        let cosine = self.dot(end);
        let (end, cosine) = if cosine < 0.0 { (-end, -cosine) } else { (end, cosine) };
        // Where both are all but one, the angle says nothing and the straight way is as good.
        if cosine > 1.0 - 1e-9 {
            return (self * (1.0 - t) + end * t).normalize();
        }
        let angle = libm::acos(cosine);
        let part = |share: f64| libm::sin(share * angle);
        ((self * part(1.0 - t) + end * part(t)) * (1.0 / libm::sin(angle))).normalize()
    }

    fn along_spline(self, leaving: Self, arriving: Self, end: Self, at: SplinePlace) -> Self {
        let [a, b, c, d] = at.hermite();
        let sum = self * a + leaving * b + arriving * c + end * d;
        // Tangents that cancel the values leave no direction; the key before is as good as any.
        if sum.length_squared() > 1e-24 {
            sum.normalize()
        } else {
            self
        }
    }
}

/// Values at times, and what lies between them. Before the first key and after the last the value stays.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyedCurve<T> {
    times: Arc<[f64]>,
    values: Vec<T>,
    interpolation: Interpolation,
}

impl<T: CurveValue> KeyedCurve<T> {
    /// A curve through `values` at `times` in seconds, one value per time, three for a spline. `None` when their numbers do not
    /// fit, when there are none, or when times are not finite or fall.
    pub fn through(times: Arc<[f64]>, values: Vec<T>, interpolation: Interpolation) -> Option<Self> {
        let each = if interpolation == Interpolation::CubicSpline {
            3
        } else {
            1
        };
        let fits = !times.is_empty() && times.len().checked_mul(each) == Some(values.len());
        let in_order = times.iter().all(|t| t.is_finite()) && times.is_sorted();
        (fits && in_order).then_some(Self {
            times,
            values,
            interpolation,
        })
    }

    /// The time of the last key.
    pub fn end(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    /// The value at a time in seconds.
    pub fn value_at(&self, seconds: f64) -> T {
        let after = self.times.partition_point(|&time| time <= seconds);
        let before = after.saturating_sub(1);
        if after == 0 || after == self.times.len() {
            return self.key(before);
        }
        let (start, end) = (self.times[before], self.times[after]);
        let span = end - start;
        let t = ((seconds - start) / span).clamp(0.0, 1.0);
        match self.interpolation {
            Interpolation::Step => self.key(before),
            Interpolation::Linear => self.key(before).between(self.key(after), t),
            Interpolation::CubicSpline => {
                let (leaving, arriving) = (self.values[3 * before + 2], self.values[3 * after]);
                let at = SplinePlace { t, span };
                self.key(before).along_spline(leaving, arriving, self.key(after), at)
            }
        }
    }

    fn key(&self, number: usize) -> T {
        match self.interpolation {
            Interpolation::CubicSpline => self.values[3 * number + 1],
            _ => self.values[number],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about_y(angle: f64) -> DQuat {
        DQuat::from_rotation_y(angle)
    }

    #[test]
    fn rotations_go_the_shorter_way_at_an_even_pace() {
        let curve = KeyedCurve::through(
            [0.0, 1.0].into(),
            vec![about_y(0.1), -about_y(2.1)],
            Interpolation::Linear,
        )
        .expect("a curve");
        for (t, angle) in [(-1.0, 0.1), (0.0, 0.1), (0.25, 0.6), (0.5, 1.1), (1.0, 2.1), (9.0, 2.1)] {
            let off = curve.value_at(t).dot(about_y(angle)).abs();
            assert!((off - 1.0).abs() < 1e-12, "{t}: {off}");
        }
    }

    #[test]
    fn a_step_waits_and_a_spline_with_even_tangents_is_straight() {
        let times: Arc<[f64]> = [0.0, 2.0].into();
        let steps = KeyedCurve::through(Arc::clone(&times), vec![DVec3::ZERO, DVec3::X], Interpolation::Step);
        assert_eq!(steps.expect("a curve").value_at(1.999), DVec3::ZERO);
        let tangent = DVec3::X * 0.5;
        let keys = vec![tangent, DVec3::ZERO, tangent, tangent, DVec3::X, tangent];
        let spline = KeyedCurve::through(times, keys, Interpolation::CubicSpline).expect("a curve");
        for k in 0..=8 {
            let t = f64::from(k) * 0.25;
            assert!(spline.value_at(t).distance(DVec3::X * (t * 0.5)) < 1e-15);
        }
    }

    #[test]
    fn keys_that_do_not_fit_make_no_curve() {
        let none = |times: &[f64], count: usize, kind| {
            KeyedCurve::through(times.into(), vec![DVec3::ZERO; count], kind).is_none()
        };
        assert!(none(&[], 0, Interpolation::Linear));
        assert!(none(&[0.0, 1.0], 1, Interpolation::Linear));
        assert!(none(&[0.0, 1.0], 2, Interpolation::CubicSpline));
        assert!(none(&[1.0, 0.0], 2, Interpolation::Linear));
        assert!(none(&[0.0, f64::NAN], 2, Interpolation::Step));
    }
}
