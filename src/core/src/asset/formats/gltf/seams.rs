//! Seams of skinned meshes stay closed: what one stored place has become is the same for all vertices that lie on it.

use glam::DVec3;
use std::collections::BTreeMap;

/// Where stored places of each skin have been put. Vertices on both sides of a seam have the same stored position, and
/// joints that agree up to rounding (in two primitives, or with weights in few bits); a solver that joins equal
/// positions would see a gap where everyone else sees none.
#[derive(Default)]
pub(super) struct SkinSeams {
    /// By skin and bits of the stored position.
    placed: BTreeMap<(usize, [u32; 3]), DVec3>,
}

/// How far apart the sides of a seam may be placed, in units of the largest coordinate.
const ROUNDING: f64 = 1e-6;

impl SkinSeams {
    /// Moves vertices to where an earlier vertex with the same stored position is, when that is the same but for rounding.
    /// `skin` identifies the skin; `placed` are the world positions of the vertices that are stored as `stored`.
    pub(super) fn close(&mut self, skin: usize, stored: &[f32], placed: &mut [DVec3]) {
        let largest = placed.iter().fold(0.0, |most: f64, p| most.max(p.abs().max_element()));
        for (stored, place) in stored.as_chunks::<3>().0.iter().zip(placed) {
            // Adding zero turns -0 into 0.
            let first = *self
                .placed
                .entry((skin, stored.map(|v| (v + 0.0).to_bits())))
                .or_insert(*place);
            if (first - *place).abs().max_element() <= ROUNDING * largest {
                *place = first;
            }
        }
    }
}
