//! Targets of single vertices: where a pose wants each vertex of a handle, and what follows for the nodes that are solved.

/// What the stiffness of a handle with targets is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StiffnessPer {
    /// Each vertex.
    #[default]
    Vertex,
    /// A share of 1/10000 of the area of the model: a vertex has the stiffness × 10000 × its area (a third of that of its
    /// triangles) / the area of the model. Handles then pull alike at any resolution of a surface.
    Area,
}

/// Where a pose wants vertices of a handle with targets.
///
/// ```
/// use pliant_core::engine::VertexTargets;
///
/// let all = VertexTargets::of([[0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]).weighted([1.0, 0.5]);
/// assert_eq!((all.first, all.positions.len()), (None, 2));
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VertexTargets {
    /// `None`: the lists have an entry for each vertex of the handle, in the order of the model's vertices. Else they are of some
    /// of them, from this one of the handle on; the others keep what they have.
    pub first: Option<u32>,
    /// The places, relative to [`DeformerFacts::origin`](super::DeformerFacts::origin). Empty: as before, which is in the rest pose to
    /// begin with.
    pub positions: Vec<[f32; 3]>,
    /// What each of them weighs, 0 or more: a factor of the stiffness; of all vertices, one number is for each. Empty: as before, which is
    /// 1 to begin with.
    pub weights: Vec<f32>,
    /// Across the planes that vertices of a handle with [`Handle::tangential`](super::Handle::tangential) are wanted in; of any length,
    /// and of none where a vertex is wanted at its target. Empty: as before, which is those of the surface that the targets make to
    /// begin with.
    pub normals: Vec<[f32; 3]>,
}

impl VertexTargets {
    /// Makes the targets of all vertices of a handle.
    pub fn of(positions: impl IntoIterator<Item = [f32; 3]>) -> Self {
        Self {
            positions: positions.into_iter().collect(),
            ..Self::default()
        }
    }

    /// Adds weights.
    #[must_use]
    pub fn weighted(self, weights: impl IntoIterator<Item = f32>) -> Self {
        let weights = weights.into_iter().collect();
        Self { weights, ..self }
    }

    /// Adds normals.
    #[must_use]
    pub fn across(self, normals: impl IntoIterator<Item = [f32; 3]>) -> Self {
        let normals = normals.into_iter().collect();
        Self { normals, ..self }
    }

    /// Whether the weights are one number, which is for all vertices of the handle.
    pub(super) fn has_one_weight(&self) -> bool {
        self.first.is_none() && self.weights.len() == 1
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        let lists = size_of_val(&self.positions[..]) + size_of_val(&self.weights[..]) + size_of_val(&self.normals[..]);
        size_of::<Self>() + lists
    }

    /// These on top of `before`, for all vertices of a handle, whose rest positions are given.
    pub(super) fn on_top_of(&self, before: Option<&Self>, rest: &[[f32; 3]]) -> Self {
        let (first, count) = (self.first, rest.len());
        Self {
            first: None,
            positions: laid(before.map(|b| &b.positions), &self.positions, first, || rest.to_vec()),
            weights: laid(before.map(|b| &b.weights), &self.weights, first, || vec![1.0; count]),
            // Without a normal a vertex is wanted at its target.
            normals: laid(before.map(|b| &b.normals), &self.normals, first, || {
                vec![[0.0; 3]; count]
            }),
        }
    }
}

/// A list with `change` on top: all of it, or from a place on, which is within.
fn laid<T: Copy>(
    before: Option<&Vec<T>>,
    change: &[T],
    first: Option<u32>,
    to_begin_with: impl FnOnce() -> Vec<T>,
) -> Vec<T> {
    let before = before.filter(|list| !list.is_empty());
    match first {
        _ if change.is_empty() => before.cloned().unwrap_or_default(),
        None => change.to_vec(),
        Some(first) => {
            let mut all = before.cloned().unwrap_or_else(to_begin_with);
            all[first as usize..first as usize + change.len()].copy_from_slice(change);
            all
        }
    }
}
