//! Where a surface passes through itself: the checked request, and the answer.

use super::{Error, pb};
use pliant_mesh::Crossing;

/// Triangles that a list names where none is said, and at most.
const USUAL: u32 = 100_000;
const MOST: u32 = 1_000_000;

/// A request for crossings. Made by [`crossings_order`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CrossingsOrder {
    /// The most triangles that each list of the answer may name.
    pub limit: usize,
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
    Ok(CrossingsOrder { limit: limit as usize })
}

impl CrossingsOrder {
    /// Writes what the triangles of a model cross; the caller adds the revision.
    pub fn answer(&self, found: &[Crossing]) -> pb::CrossingsResponse {
        let of = |kind: Crossing| {
            let all = (0u32..).zip(found).filter(move |(_, crossing)| **crossing == kind);
            let named: Vec<u32> = all.clone().take(self.limit).map(|(triangle, _)| triangle).collect();
            (named, u32::try_from(all.count()).unwrap_or(u32::MAX))
        };
        let ((triangles, total), (at_rest, total_at_rest)) = (of(Crossing::New), of(Crossing::AtRest));
        pb::CrossingsResponse {
            revision: 0,
            triangles,
            total,
            at_rest,
            total_at_rest,
        }
    }
}
