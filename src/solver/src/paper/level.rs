//! One graph G^l of the hierarchy: who is joined to whom, and who is elevated to the next level.

/// In [`PaperLevel::elevated`]: the vertex is retained.
pub(super) const RETAINED: u32 = u32::MAX;

/// A graph without numbers on its edges, and its split into elevated and retained vertices.
#[derive(Debug, Default)]
pub(super) struct PaperLevel {
    /// Where each row of `neighbours` begins, and the end.
    pub(super) offsets: Vec<usize>,
    /// Neighbours of all rows, ascending within a row.
    pub(super) neighbours: Vec<u32>,
    /// Rest positions, which only the distance threshold δ looks at; empty where none are known.
    pub(super) positions: Vec<[f64; 3]>,
    /// Number of each vertex on the next level, or [`RETAINED`]. Empty on the coarsest level.
    pub(super) elevated: Vec<u32>,
    /// The vertex here of each vertex of the next level, ascending: the inverse of `elevated`.
    pub(super) seeds: Vec<u32>,
}

impl PaperLevel {
    pub(super) fn vertices(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Entries of row `i`, as places in `neighbours`.
    #[inline]
    pub(super) fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.offsets[i]..self.offsets[i + 1]
    }

    /// Entries of row `i` with the neighbour that each names.
    #[inline]
    pub(super) fn edges(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.row(i).map(|e| (e, self.neighbours[e] as usize))
    }

    /// Edges of `i` to elevated neighbours: the entry, and the neighbour's number on the next level. R(i) of the paper.
    #[inline]
    pub(super) fn to_elevated(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.edges(i)
            .map(|(e, j)| (e, self.elevated[j]))
            .filter(|(_, c)| *c != RETAINED)
            .map(|(e, c)| (e, c as usize))
    }

    /// Edges of `i` to retained neighbours: the entry and the neighbour. K(i) of the paper.
    #[inline]
    pub(super) fn to_retained(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.edges(i).filter(|(_, j)| self.elevated[*j] == RETAINED)
    }

    pub(super) fn byte_size(&self) -> usize {
        8 * self.offsets.len()
            + 24 * self.positions.len()
            + 4 * (self.neighbours.len() + self.elevated.len() + self.seeds.len())
    }
}
