//! What poses give to holds, with the fields that say where each of it counts.

use crate::fields::HarmonicFields;
use crate::shares::SparseShares;
use pliant_solver::prefetch;

/// Values of some holds, and the fields that say where each of them counts.
pub(crate) enum FieldTerms<'a, T> {
    /// Whole fields, in the order of holds.
    Whole(Vec<(&'a [f32], T)>),
    /// Shares by node, and the values by hold.
    Sparse(&'a SparseShares, Vec<Option<T>>),
}

impl<'a, T> FieldTerms<'a, T> {
    /// Those of `values`, by rising hold.
    pub fn new(fields: &'a HarmonicFields, values: impl Iterator<Item = (usize, T)>) -> Self {
        match fields.sparse() {
            None => Self::Whole(values.map(|(hold, value)| (fields.of(hold), value)).collect()),
            Some(shares) => {
                let mut by_hold = Vec::new();
                for (hold, value) in values {
                    by_hold.resize_with(hold + 1, || None);
                    by_hold[hold] = Some(value);
                }
                Self::Sparse(shares, by_hold)
            }
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        match self {
            Self::Whole(terms) => terms.is_empty(),
            Self::Sparse(_, values) => values.is_empty(),
        }
    }

    /// Calls `each` with the share of every hold at a node and its value, by rising hold; of whole fields also where a share is 0.
    #[inline]
    pub fn each_at(&self, node: usize, mut each: impl FnMut(f32, &T)) {
        match self {
            Self::Whole(terms) => {
                for (field, value) in terms {
                    each(field.get(node).copied().unwrap_or(0.0), value);
                }
            }
            Self::Sparse(shares, values) => {
                for &(hold, share) in shares.at(node) {
                    if let Some(Some(value)) = values.get(hold as usize) {
                        each(share, value);
                    }
                }
            }
        }
    }

    /// Asks memory for what the shares of a node are read from.
    #[inline]
    pub fn prefetch(&self, node: usize) {
        match self {
            Self::Whole(terms) => terms.iter().for_each(|(field, _)| prefetch(field, node)),
            Self::Sparse(shares, _) => shares.prefetch(node),
        }
    }
}
