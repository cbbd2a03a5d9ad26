//! Where a surface passes through itself: the checked request, and the answer.

use super::{Error, pb};
use pliant_mesh::{Crossing, CrossingPair, CrossingPairs, PairKind};

/// Triangles that a list names where none is said, and at most.
const USUAL: u32 = 100_000;
const MOST: u32 = 1_000_000;

/// A request for crossings. Made by [`crossings_order`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CrossingsOrder {
    /// The most triangles that each list of the answer may name.
    pub limit: usize,
    /// Whether pairs are wanted.
    pub pairs: bool,
}

/// Reads a request for crossings.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn crossings_order(request: &pb::CrossingsRequest) -> Result<CrossingsOrder, Error> {
    let limit = match request.limit {
        0 => USUAL,
        limit if limit <= MOST => limit,
        limit => {
            return Err(Error::invalid(
                "limit",
                format!("is {limit}, at most {MOST} are allowed"),
            ));
        }
    };
    Ok(CrossingsOrder {
        limit: limit as usize,
        pairs: request.pairs,
    })
}

impl CrossingsOrder {
    /// Writes what the triangles of a model cross, and the pairs if they are wanted; the caller adds the revision.
    pub fn answer(&self, found: &[Crossing], pairs: &CrossingPairs) -> pb::CrossingsResponse {
        let of = |kind: Crossing| {
            let all = (0u32..).zip(found).filter(move |(_, crossing)| **crossing == kind);
            let named: Vec<u32> = all.clone().take(self.limit).map(|(triangle, _)| triangle).collect();
            (named, narrow(all.count() as u64))
        };
        let ((triangles, total), (at_rest, total_at_rest)) = (of(Crossing::New), of(Crossing::AtRest));
        pb::CrossingsResponse {
            revision: 0,
            triangles,
            total,
            at_rest,
            total_at_rest,
            pairs: pairs.pairs.iter().map(pair_message).collect(),
            new_pairs: narrow(pairs.new),
            at_rest_pairs: narrow(pairs.at_rest),
            held_pairs: narrow(pairs.held),
        }
    }
}

fn narrow(count: u64) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

fn pair_message(pair: &CrossingPair) -> pb::crossings_response::Pair {
    use pb::crossings_response::pair::Kind;
    let kind = match pair.kind {
        PairKind::New => Kind::New,
        PairKind::AtRest => Kind::AtRest,
        PairKind::Held => Kind::Held,
    };
    let [first, second] = pair.triangles;
    pb::crossings_response::Pair {
        first,
        second,
        kind: kind.into(),
        at: pair.at.to_array().to_vec(),
        depth: pair.depth,
    }
}
