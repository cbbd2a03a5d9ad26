//! How much of the way from one handle to another an edge goes: what cannot bend cannot show more of it than one step.

use super::ownership::NOBODY;
use super::system::HandleSystem;

/// What handles have to say at a place: the number of each that has any, rising, and its field there, above 0.
pub type HandleShares = Vec<(u32, f32)>;

impl HandleSystem {
    /// What the handles have to say at a node, from their rotation fields; where none constrains rotation, who holds it.
    pub fn shares_at(&self, node: usize) -> HandleShares {
        let fields = (0u32..).zip(&self.rotation_fields.fields);
        let shares = fields.filter_map(|(k, field)| field.get(node).map(|&u| (k, u)));
        let shares: HandleShares = shares.filter(|&(_, u)| u > 0.0).collect();
        match self.position.hard[node] {
            hold if shares.is_empty() && hold != NOBODY => vec![(hold, 1.0)],
            _ => shares,
        }
    }

    /// What part of the way between handles lies between two nodes, 0 to 1: half of what their shares differ by.
    pub fn way_between(&self, a: usize, b: usize) -> f64 {
        shares_difference(&self.shares_at(a), &self.shares_at(b))
    }
}

/// Half the sum of the differences of two places' shares. Where handles have a say in one place alone, that is half of the
/// way as well.
pub fn shares_difference(a: &[(u32, f32)], b: &[(u32, f32)]) -> f64 {
    let (mut i, mut j, mut sum) = (0, 0, 0.0);
    while i < a.len() || j < b.len() {
        let next = |list: &[(u32, f32)], at: usize| list.get(at).map_or(u32::MAX, |s| s.0);
        let (ka, kb) = (next(a, i), next(b, j));
        let mut difference = 0.0;
        if ka <= kb {
            difference += f64::from(a[i].1);
            i += 1;
        }
        if kb <= ka {
            difference -= f64::from(b[j].1);
            j += 1;
        }
        sum += difference.abs();
    }
    0.5 * sum
}
