//! The arms of a body of cells: limbs that end at its sides and begin where a trunk does.

use super::body_lattice::FAR;
use super::body_search::{BodySearch, Legs, median};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;

/// Tenths of a cell in a band of an arm.
const BAND: u32 = 15;
/// A band that is so many times as large as those before it is the trunk.
const GROWTH: f64 = 2.0;
/// A band of an arm is at most so many times as large as those before it.
const SWELLING: f64 = 1.3;
/// Limbs that are looked at on each side.
const MOST_LIMBS: usize = 4;

/// A limb that may be an arm.
#[derive(Debug, Clone)]
pub(super) struct Arm {
    /// From the finger's tip to the shoulder.
    pub(super) line: Vec<DVec3>,
    /// Half as thick as it is.
    pub(super) radius: f64,
    /// How much thicker it is half way than where it begins.
    pub(super) bulge: f64,
}

impl Arm {
    pub(super) fn length(&self) -> f64 {
        self.line.windows(2).map(|w| w[0].distance(w[1])).sum()
    }

    pub(super) fn shoulder(&self) -> DVec3 {
        self.line[self.line.len() - 1]
    }
}

/// How good something is, 0 to 1, and what is wrong with it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judged {
    pub(super) score: f64,
    worst: f64,
    pub(super) reason: String,
}

impl Judged {
    pub(super) const GOOD: Self = Self {
        score: 1.0,
        worst: 1.0,
        reason: String::new(),
    };

    /// Multiplies the score by a factor; the reason of the smallest factor stays.
    pub(super) fn lower(&mut self, factor: f64, reason: impl FnOnce() -> String) {
        // What cannot be measured is nothing.
        let factor = if factor > 0.0 { factor.min(1.0) } else { 0.0 };
        self.score *= factor;
        if factor < self.worst.min(0.95) {
            self.worst = factor;
            self.reason = reason();
        }
    }

    pub(super) fn lower_as(&mut self, other: &Self) {
        self.lower(other.score, || other.reason.clone());
    }
}

/// A share of the way from one value to another.
pub(super) fn between(value: f64, nothing: f64, all: f64) -> f64 {
    ((value - nothing) / (all - nothing)).clamp(0.0, 1.0)
}

impl BodySearch {
    /// The limbs of each side that may be arms, left first.
    pub(super) fn arms(&self, legs: &Legs, exec: &Exec<'_>) -> Result<[Vec<Arm>; 2], Cancelled> {
        let share = legs.crotch + 0.4 * (1.0 - legs.crotch);
        let near = 0.1 * self.extent.x;
        let places = &self.lattice.places;
        let trunk = self
            .middle_of_row(share, |c| (places[c].x - self.middle).abs() < near)
            .unwrap_or(self.low + 0.5 * self.extent);
        let trunk = self.lattice.cell_near(DVec3::new(self.middle, trunk.y, trunk.z));
        let is_open: Vec<bool> = legs.side_of.iter().map(|side| *side == 0).collect();
        let from_trunk = self.lattice.distances_from(trunk, &is_open);
        let mut found = [Vec::new(), Vec::new()];
        for (sign, found) in [1.0, -1.0].into_iter().zip(&mut found) {
            exec.check()?;
            *found = self.arms_of_side(sign, &from_trunk, &is_open);
        }
        Ok(found)
    }

    fn arms_of_side(&self, sign: f64, from_trunk: &[u32], is_open: &[bool]) -> Vec<Arm> {
        let side_way = |p: DVec3| (p.x - self.middle) * sign;
        let mut is_left: Vec<bool> = self
            .lattice
            .places
            .iter()
            .zip(from_trunk)
            .map(|(p, far)| *far != FAR && side_way(*p) > 0.1 * self.extent.x)
            .collect();
        let mut arms = Vec::new();
        for _ in 0..MOST_LIMBS {
            let reach =
                |c: usize| f64::from(from_trunk[c]) / 10.0 + side_way(self.lattice.places[c]) / self.lattice.side;
            let ranked = (0..is_left.len()).filter(|c| is_left[*c]).map(|c| (reach(c), c));
            let Some((_, tip)) = ranked.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))) else {
                break;
            };
            let from_tip = self.lattice.distances_from(tip, is_open);
            let (arm, length) = self.arm_from_tip(&from_tip);
            arms.extend(arm);
            let claimed = length.max((0.08 * self.extent.y / self.lattice.side * 10.0) as u32);
            for (is_left, far) in is_left.iter_mut().zip(&from_tip) {
                *is_left &= *far > claimed;
            }
        }
        arms
    }

    /// The limb that ends at a tip, where there is one, and how far it goes in tenths of a cell.
    fn arm_from_tip(&self, from_tip: &[u32]) -> (Option<Arm>, u32) {
        let height = self.extent.y;
        let bands = self.bands(from_tip, (height / self.lattice.side * 7.0) as u32);
        let cells_a_band = f64::from(BAND) / 10.0;
        let bands_of = |length: f64| length / (self.lattice.side * cells_a_band);
        let hand = bands_of(0.1 * height).ceil() as usize;
        let limit = bands_of(0.65 * height) as usize;
        let mut last = None;
        for band in hand..limit.min(bands.len().saturating_sub(1)) {
            let before = median(bands[hand / 2..band].iter().map(|b| b.1).collect());
            if bands[band].1 > GROWTH * before && bands[band + 1].1 > GROWTH * before {
                // The joint lies where it begins to grow, not where it is all trunk.
                let small = (hand..band).rev().find(|b| bands[*b].1 <= SWELLING * before);
                let least = band.saturating_sub(1 + bands_of(0.03 * height) as usize);
                last = Some(small.unwrap_or(0).max(least));
                break;
            }
        }
        let Some(last) = last.filter(|band| *band > 3) else {
            return (None, 0);
        };
        let mut line: Vec<DVec3> = bands[..=last].iter().map(|b| b.0).collect();
        let inwards = (line[last] - line[last - 3]).normalize_or_zero();
        let radius_of = |cells: f64| self.lattice.side * (cells / cells_a_band / std::f64::consts::PI).sqrt();
        let counts = |range: std::ops::Range<usize>| median(bands[range].iter().map(|b| b.1).collect());
        line.push(line[last] + inwards * (0.8 * radius_of(bands[last].1)).min(0.05 * height));
        let third = (last / 3).max(1);
        let arm = Arm {
            line,
            radius: radius_of(counts(third..last)),
            bulge: counts(third..2 * third + 1) / counts(last - third / 2..last + 1).max(1.0),
        };
        (Some(arm), last as u32 * BAND)
    }

    /// Means and counts of the cells that are so and so far.
    fn bands(&self, far: &[u32], most: u32) -> Vec<(DVec3, f64)> {
        let mut bands = vec![(DVec3::ZERO, 0.0); (most / BAND) as usize + 1];
        for (p, far) in self.lattice.places.iter().zip(far).filter(|(_, far)| **far <= most) {
            let band = &mut bands[(far / BAND) as usize];
            band.0 += *p;
            band.1 += 1.0;
        }
        bands.retain(|b| b.1 > 0.0);
        bands.iter().map(|b| (b.0 / b.1, b.1)).collect()
    }

    /// How much a limb looks like an arm.
    pub(super) fn judge_arm(&self, arm: &Arm, crotch: f64) -> Judged {
        let height = self.extent.y;
        let mut judged = Judged::GOOD;
        let length = arm.length() / height;
        let of_height = || format!("the arm is {length:.2} times as long as the figure is high");
        judged.lower(between(length, 0.06, 0.16), of_height);
        judged.lower(between(length, 0.85, 0.65), of_height);
        let slender = 0.5 * arm.length() / arm.radius.max(f64::MIN_POSITIVE);
        judged.lower(between(slender, 0.8, 1.7), || {
            "it is short for its thickness, as an ear or a fin is".into()
        });
        judged.lower(between(arm.bulge, 2.6, 1.5), || {
            "it is thickest half way, as an ear or a fin is".into()
        });
        let share = self.share_of(arm.shoulder().y);
        judged.lower(between(share - crotch, 0.06, 0.16), || {
            "the shoulder is not above the hip".into()
        });
        judged.lower(between(share, 0.97, 0.9), || "no head is above the shoulder".into());
        judged
    }

    /// How much two arms look like a pair.
    pub(super) fn judge_pair(&self, [left, right]: [&Arm; 2]) -> Judged {
        let mut judged = Judged::GOOD;
        let lengths = [left.length(), right.length()];
        let ratio = lengths[0].min(lengths[1]) / lengths[0].max(lengths[1]);
        judged.lower(between(ratio, 0.45, 0.8), || {
            format!("one arm is {:.1} times as long as the other", 1.0 / ratio)
        });
        let apart = left.shoulder() - self.mirrored(right.shoulder());
        let off = apart.y.abs() / self.extent.y;
        judged.lower(between(off, 0.17, 0.07), || {
            "the shoulders are not at one height".into()
        });
        let width = 0.5 * (left.shoulder().x - right.shoulder().x).abs() / self.extent.y;
        judged.lower(between(width, 0.36, 0.28), || {
            "the shoulders are far out, where the arms are not yet the trunk".into()
        });
        judged.lower(between(width, 0.01, 0.04), || {
            "the arms begin in the middle of the body".into()
        });
        let off = libm::hypot(apart.x, apart.z) / self.extent.y;
        judged.lower(between(off, 0.25, 0.12), || {
            "the shoulders are not a mirrored pair".into()
        });
        judged
    }
}
