//! A scale, a rotation and a translation, and the one that fits pairs of places best.

use crate::mesh::rotation::{fit_rotation, outer_product};
use glam::{DMat3, DQuat, DVec3};

/// Scaled, then turned, then moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Similarity {
    pub scale: f64,
    pub rotation: DQuat,
    pub translation: DVec3,
}

/// Two places that belong together, and what they weigh.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlacePair {
    pub from: DVec3,
    pub to: DVec3,
    pub weight: f64,
}

/// Landmarks whose second moment is a smaller share of the first are on a line, and say nothing of the turn about it.
const ON_A_LINE: f64 = 1e-3;
impl Similarity {
    /// Where a point goes.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.rotation * (p * self.scale) + self.translation
    }

    /// How a direction turns.
    pub fn turn(&self, direction: DVec3) -> DVec3 {
        self.rotation * direction
    }

    /// The way back.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Self {
            scale,
            rotation,
            translation: rotation * (self.translation * -scale),
        }
    }

    /// The one that takes the first places nearest to the second ones (Horn 1987); `None` where they leave the turn open.
    pub fn of_pairs(pairs: &[PlacePair]) -> Option<Self> {
        let whole: f64 = pairs.iter().map(|p| p.weight).sum();
        let mean = |of: fn(&PlacePair) -> DVec3| pairs.iter().map(|p| of(p) * p.weight).sum::<DVec3>() / whole;
        let (from, to) = (mean(|p| p.from), mean(|p| p.to));
        let mut cross = DMat3::ZERO;
        let (mut spread, mut squares) = (DMat3::ZERO, [0.0; 2]);
        for pair in pairs {
            let (a, b) = (pair.from - from, pair.to - to);
            cross += outer_product(b, a) * pair.weight;
            spread += outer_product(a, a) * pair.weight;
            squares[0] += a.length_squared() * pair.weight;
            squares[1] += b.length_squared() * pair.weight;
        }
        // The sum of the principal minors is that of the products of two moments: 0 for places on a line.
        let d = [0, 1, 2].map(|k| spread.col(k)[k]);
        let minor = |i: usize, j: usize| d[i] * d[j] - spread.col(i)[j] * spread.col(i)[j];
        let minors = minor(0, 1) + minor(1, 2) + minor(0, 2);
        if !(squares[1] > 0.0 && minors > ON_A_LINE * squares[0] * squares[0]) {
            return None;
        }
        let rotation = fit_rotation(cross);
        let scale = (squares[1] / squares[0]).sqrt();
        Some(Self {
            scale,
            rotation,
            translation: to - rotation * (from * scale),
        })
    }
}
