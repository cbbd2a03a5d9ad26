//! Sets of render vertices.

/// Which render vertices belong to something.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct VertexSet(Vec<bool>);

impl VertexSet {
    /// No vertex of so many.
    pub fn none(count: usize) -> Self {
        Self(vec![false; count])
    }

    /// The vertices that fit.
    pub fn of(count: usize, fits: impl FnMut(usize) -> bool) -> Self {
        Self((0..count).map(fits).collect())
    }

    /// The listed vertices of so many.
    pub fn of_list(count: usize, list: &[u32]) -> Self {
        let mut set = Self::none(count);
        for &vertex in list {
            if let Some(own) = set.0.get_mut(vertex as usize) {
                *own = true;
            }
        }
        set
    }

    /// Whether it holds a vertex.
    pub fn has(&self, vertex: usize) -> bool {
        self.0.get(vertex).copied().unwrap_or(false)
    }

    /// How many it holds.
    pub fn count(&self) -> usize {
        self.0.iter().filter(|has| **has).count()
    }

    /// Its vertices, ascending.
    pub fn list(&self) -> Vec<u32> {
        (0u32..).zip(&self.0).filter(|(_, has)| **has).map(|(v, _)| v).collect()
    }

    /// What is in this one or the other.
    pub fn or(mut self, other: &Self) -> Self {
        self.0.iter_mut().zip(&other.0).for_each(|(own, more)| *own |= more);
        self
    }

    /// What is in both.
    pub fn and(mut self, other: &Self) -> Self {
        self.0.iter_mut().zip(&other.0).for_each(|(own, more)| *own &= more);
        self
    }

    /// What is in this one and not in the other.
    pub fn minus(mut self, other: &Self) -> Self {
        self.0.iter_mut().zip(&other.0).for_each(|(own, less)| *own &= !less);
        self
    }
}
