//! Which bones a vertex follows, and how much each.

use glam::DVec3;

/// The bones that a vertex follows: at most eight, with weights that are not negative and add up to one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BoneInfluences {
    /// Numbers of the bones, heaviest first; those without weight are 0.
    pub bones: [u16; Self::MOST],
    /// Their weights.
    pub weights: [f64; Self::MOST],
}

impl BoneInfluences {
    /// The most bones that a vertex follows.
    pub const MOST: usize = 8;

    /// One bone alone.
    pub fn one(bone: u16) -> Self {
        Self {
            bones: [bone, 0, 0, 0, 0, 0, 0, 0],
            weights: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        }
    }

    /// The bones with weight, and their weights.
    pub fn iter(&self) -> impl Iterator<Item = (usize, f64)> + Clone + '_ {
        let all = self.bones.iter().zip(&self.weights);
        all.filter(|(_, w)| **w > 0.0).map(|(b, w)| (usize::from(*b), *w))
    }

    /// Puts pairs in order, the heaviest first and bones in rising order where weights are equal, and scales them to add up
    /// to one. Pairs beyond the eighth are left out. `None` without any weight.
    pub fn from_pairs(pairs: &mut [(u16, f64)]) -> Option<Self> {
        pairs.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let kept = &pairs[..pairs.len().min(Self::MOST)];
        let sum: f64 = kept.iter().map(|p| p.1).sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        let mut found = Self::default();
        for (k, (bone, weight)) in kept.iter().filter(|p| p.1 > 0.0).enumerate() {
            found.bones[k] = *bone;
            found.weights[k] = weight / sum;
        }
        Some(found)
    }

    /// The weighted mean of what each bone does with a point.
    pub fn blend(&self, place: impl Fn(usize) -> DVec3) -> DVec3 {
        self.iter().map(|(bone, weight)| place(bone) * weight).sum()
    }
}
