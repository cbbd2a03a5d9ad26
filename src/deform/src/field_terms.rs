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

    /// The same fields with other values.
    pub fn map<U>(self, to: impl Fn(T) -> U) -> FieldTerms<'a, U> {
        match self {
            Self::Whole(terms) => {
                FieldTerms::Whole(terms.into_iter().map(|(field, value)| (field, to(value))).collect())
            }
            Self::Sparse(shares, values) => {
                FieldTerms::Sparse(shares, values.into_iter().map(|value| value.map(&to)).collect())
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

    /// The same at nodes side by side; `each` gets the number of the node among them first. A number that names no node has no shares.
    #[inline(always)]
    pub fn each_beside<const N: usize>(&self, nodes: &[u32; N], mut each: impl FnMut(usize, f32, &T)) {
        match self {
            Self::Whole(terms) => {
                for (field, value) in terms {
                    for (lane, &node) in nodes.iter().enumerate() {
                        each(lane, field.get(node as usize).copied().unwrap_or(0.0), value);
                    }
                }
            }
            Self::Sparse(..) => {
                for (lane, &node) in nodes.iter().enumerate() {
                    self.each_at(node as usize, |share, value| each(lane, share, value));
                }
            }
        }
    }

    /// Asks memory for what the shares of nodes are read from.
    #[inline(always)]
    pub fn prefetch<const N: usize>(&self, nodes: &[u32; N]) {
        match self {
            Self::Whole(terms) => {
                for (field, _) in terms {
                    nodes.iter().for_each(|&node| prefetch(field, node as usize));
                }
            }
            Self::Sparse(shares, _) => nodes.iter().for_each(|&node| shares.prefetch(node as usize)),
        }
    }
}
