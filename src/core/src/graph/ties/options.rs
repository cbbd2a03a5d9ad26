//! How parts are to be tied.

use crate::mesh::Components;
use std::sync::Arc;

/// Among [`TieFamilies::Of`]: a vertex of a part that gets no ties.
pub const LOOSE: u32 = u32::MAX;

/// How parts of a mesh are tied to each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TieOptions {
    /// How far apart places of two parts may lie to be tied, model units. By default half the length of the edges around,
    /// at least 0.5 % and at most 2 % of the diagonal of the mesh's bounding box.
    pub distance: Option<f64>,
    /// Which parts may be tied to each other.
    pub families: TieFamilies,
}

/// Which parts of a mesh may be tied to each other: those of different families.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum TieFamilies {
    /// Each connected part is a family of its own.
    #[default]
    EachPart,
    /// All parts are of one family: nothing is tied.
    One,
    /// The family of each vertex of the mesh, or [`LOOSE`]. All vertices of a connected part are of one family, and so may be
    /// several parts, such as the pieces of a cut.
    Of(Arc<Vec<u32>>),
}

impl TieOptions {
    /// The family of each vertex; `None` where all are of one.
    pub(super) fn family_of_vertex<'a>(&'a self, parts: &'a Components) -> Option<&'a [u32]> {
        match &self.families {
            TieFamilies::One => None,
            TieFamilies::EachPart => (parts.count > 1).then_some(&parts.of_vertex),
            TieFamilies::Of(families) => Some(families),
        }
    }
}
