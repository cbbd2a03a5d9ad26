//! Attributes of primitives that become others.

use super::slots::AttributeSlot;
use std::hash::{Hash as _, Hasher as _};

/// New values of one attribute, all elements, lane by lane.
#[derive(Debug, Clone)]
pub(super) struct ChangedAttribute {
    pub(super) values: Vec<f32>,
    /// Which elements differ from the stored ones.
    pub(super) changed: Vec<bool>,
}

impl ChangedAttribute {
    pub(super) fn where_changed(stored: &[f32], values: Vec<f32>, lanes: usize) -> Option<Self> {
        let differ = |(a, b): (&[f32], &[f32])| a.iter().zip(b).any(|(a, b)| a.to_bits() != b.to_bits());
        let changed: Vec<bool> = stored
            .chunks_exact(lanes)
            .zip(values.chunks_exact(lanes))
            .map(differ)
            .collect();
        changed.contains(&true).then_some(Self { values, changed })
    }

    /// Equal for what is the same, nearly always different for what is not.
    pub(super) fn fingerprint(&self) -> u64 {
        let mut hasher = std::hash::DefaultHasher::new();
        self.values.iter().for_each(|v| hasher.write_u32(v.to_bits()));
        hasher.finish()
    }

    /// Whether two attributes become the same.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.values.len() == other.values.len()
            && self
                .values
                .iter()
                .zip(&other.values)
                .all(|(a, b)| a.to_bits() == b.to_bits())
    }
}

/// What one row of the primitive table should become: the slots that change, in order.
#[derive(Debug, Clone, Default)]
pub(super) struct DeformedAttributes(pub(super) Vec<(AttributeSlot, ChangedAttribute)>);

impl DeformedAttributes {
    pub(super) fn is_changed(&self) -> bool {
        !self.0.is_empty()
    }

    /// What a slot becomes; `None` when it stays as it is stored.
    pub(super) fn of(&self, slot: AttributeSlot) -> Option<&ChangedAttribute> {
        let at = self.0.binary_search_by_key(&slot, |(slot, _)| *slot).ok()?;
        Some(&self.0[at].1)
    }

    /// Equal for what is the same, nearly always different for what is not.
    pub(super) fn fingerprint(&self) -> u64 {
        let mut hasher = std::hash::DefaultHasher::new();
        for (slot, change) in &self.0 {
            slot.hash(&mut hasher);
            change.values.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        }
        hasher.finish()
    }

    pub(super) fn is_same(&self, other: &Self) -> bool {
        let pairs = || self.0.iter().zip(&other.0);
        self.0.len() == other.0.len() && pairs().all(|(a, b)| a.0 == b.0 && a.1.is_same(&b.1))
    }
}
