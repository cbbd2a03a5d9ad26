//! Weights that bind a mesh of any kind to the bones of a rig: soups, open surfaces and thousands of parts too.
//!
//! Heat that flows over the surface (bone heat, Baran and Popović 2007) never reaches parts that hang together with no other,
//! and needs a surface that is one. Here it flows through a lattice over the union of all parts: every cell that holds a
//! vertex, that a triangle passes or that lies inside (`cell_paths`), and heat does not cross the air between parts that
//! nearly touch. Each is pulled to the bone nearest through the cells with a stiffness of c / d², d in cells, and one solve
//! on multigrid for all bones has the balance (`heat_columns`). Of a cell's weights
//! the few heaviest are kept, without a jump where another becomes heavier (`four_heaviest`), and smoothed where that took
//! something away. A vertex takes its weights from the cells around it, and weights that jump along an edge are evened out
//! (`even_jumps`). As each cell is pulled to some bone, no vertex is left out.

mod cell_paths;
mod even_jumps;
mod heat_columns;

use super::skeleton::BoneInfluences;
pub(super) use cell_paths::OccupiedCells;
pub use cell_paths::SkinBone;
pub use heat_columns::{SkinWeightError, SkinWeightOptions, skin_weights};

/// Weights kept of each vertex; what comes after them is nothing that shows.
const KEPT: usize = 12;
/// Bones that mixtures are made of at most: eight parts of as many as a vertex may follow.
const SUMS: usize = 8 * BoneInfluences::MOST;
/// What is left out goes to bones that are one step further along the skeleton by this factor less.
const STEP: f64 = 0.5;
/// Steps that are counted.
const FAR: i32 = 40;

/// The heaviest weights of a vertex that were seen so far.
#[derive(Debug, Clone, Copy, Default)]
struct HeaviestWeights {
    /// Heaviest first.
    kept: [(u16, f64); KEPT],
}

impl HeaviestWeights {
    /// Adds the weight of one more bone. Bones come in rising order; of equal weights the first seen counts as heavier.
    fn add(&mut self, bone: u16, weight: f64) {
        let mut entry = (bone, weight);
        for place in &mut self.kept {
            if entry.1 > place.1 {
                std::mem::swap(place, &mut entry);
            }
        }
    }

    /// The heaviest of weighted sums of what others follow.
    fn of_mixture<'a>(parts: impl Iterator<Item = (&'a BoneInfluences, f64)>) -> Self {
        let mut sums = [(0u16, 0.0); SUMS];
        let mut count = 0;
        for (own, share) in parts {
            for (bone, weight) in own.iter() {
                let bone = bone as u16;
                match sums[..count].iter_mut().find(|s| s.0 == bone) {
                    Some(sum) => sum.1 += share * weight,
                    None if count < SUMS => {
                        sums[count] = (bone, share * weight);
                        count += 1;
                    }
                    None => {}
                }
            }
        }
        sums[..count].sort_unstable_by_key(|s| s.0);
        let mut mixed = Self::default();
        sums[..count]
            .iter()
            .for_each(|(bone, weight)| mixed.add(*bone, *weight));
        mixed
    }

    /// What share of all weight a cut to so many takes away.
    fn share_cut(&self, most: usize) -> f64 {
        let floor = self.kept[most.clamp(1, BoneInfluences::MOST)].1;
        let (all, taken) = self
            .kept
            .iter()
            .fold((0.0, 0.0), |sums, k| (sums.0 + k.1, sums.1 + k.1.min(floor)));
        if all > 0.0 { taken / all } else { 0.0 }
    }

    /// At most `most` influences; `parents` has the bone that each hangs on, which has a lower number.
    ///
    /// The heaviest weight that is left out is taken from all, so that a bone comes and goes with a weight of nothing and
    /// weights are continuous. What was taken goes to the bones that stay, in proportion to what they have left and the more
    /// the nearer they are along the skeleton, as those move most alike. Where all are equal they stay as they are.
    fn cut(&self, most: usize, parents: &[Option<usize>]) -> Option<BoneInfluences> {
        let most = most.clamp(1, BoneInfluences::MOST);
        let floor = self.kept[most].1;
        let mut cut = [(0u16, 0.0); BoneInfluences::MOST];
        for (to, kept) in cut.iter_mut().zip(&self.kept[..most]) {
            *to = (kept.0, kept.1 - floor);
        }
        if cut[0].1 <= 1e-6 * self.kept[0].1 {
            cut.copy_from_slice(&self.kept[..BoneInfluences::MOST]);
            return BoneInfluences::from_pairs(&mut cut[..most]);
        }
        let left = cut;
        for (bone, weight) in self.kept.iter().filter(|k| k.1 > 0.0) {
            let near = |k: usize| left[k].1 * STEP.powi(steps(parents, usize::from(*bone), usize::from(left[k].0)));
            let sum: f64 = (0..most).map(near).sum();
            for (k, to) in cut.iter_mut().enumerate().take(most) {
                to.1 += weight.min(floor) * near(k) / sum;
            }
        }
        BoneInfluences::from_pairs(&mut cut[..most])
    }
}

/// Steps from bone to bone along a skeleton.
fn steps(parents: &[Option<usize>], from: usize, to: usize) -> i32 {
    let (mut a, mut b) = (from, to);
    let mut count = 0;
    // Whichever has the higher number cannot be above the other.
    while a != b && count < FAR {
        let above = parents.get(a.max(b)).copied().flatten();
        let Some(above) = above else { return FAR };
        if a > b {
            a = above;
        } else {
            b = above;
        }
        count += 1;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain.
    const PARENTS: [Option<usize>; 5] = [None, Some(0), Some(1), Some(2), Some(3)];

    fn cut(weights: &[f64], most: usize) -> Vec<(usize, f64)> {
        let mut heaviest = HeaviestWeights::default();
        (0u16..).zip(weights).for_each(|(bone, w)| heaviest.add(bone, *w));
        heaviest.cut(most, &PARENTS).expect("weights").iter().collect()
    }

    #[test]
    fn a_bone_that_becomes_the_fourth_begins_with_nothing() {
        let before = cut(&[0.4, 0.3, 0.12, 0.0901, 0.0899], 4);
        let after = cut(&[0.4, 0.3, 0.12, 0.0899, 0.0901], 4);
        assert_eq!(before[3].0, 3);
        assert_eq!(after[3].0, 4);
        assert!(before[3].1 < 2e-3 && after[3].1 < 2e-3);
        for k in 0..3 {
            assert_eq!(before[k].0, after[k].0);
            assert!((before[k].1 - after[k].1).abs() < 2e-3);
        }
    }

    #[test]
    fn what_is_left_out_goes_to_the_bones_next_to_it() {
        let found = cut(&[0.4, 0.0, 0.0, 0.4, 0.2], 2);
        assert_eq!(found[0].0, 3, "bone 4 hangs on bone 3");
        assert!(found[0].1 > 0.55 && (found[0].1 + found[1].1 - 1.0).abs() < 1e-12);
        assert_eq!(steps(&PARENTS, 4, 1), 3);
        assert_eq!(steps(&[None, Some(0), Some(0)], 1, 2), 2);
        assert_eq!(steps(&[None, None], 0, 1), FAR);
    }

    #[test]
    fn few_weights_stay_as_they_are_and_equal_ones_share() {
        assert_eq!(cut(&[0.25, 0.75], 4), [(1, 0.75), (0, 0.25)]);
        assert_eq!(cut(&[0.2; 5], 4).len(), 4);
        assert_eq!(cut(&[0.1, 0.2, 0.7], 1), [(2, 1.0)]);
    }
}
