//! What the vertices of an edited model are made of: old vertices and weights.

/// For each vertex of an edited model the render vertices of one [`BaseModel`](super::BaseModel) that its attributes are blended
/// from. Nearly all vertices of an edited model are old ones, which take four bytes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VertexBlends {
    /// The old vertex; or, with [`BLEND`] set, the number of a blend.
    of: Vec<u32>,
    /// For each blend where its entries begin; they end where the next one's begin.
    starts: Vec<u32>,
    entries: Vec<(u32, f32)>,
}

/// Marks a vertex that is made of several. Vertices of a base are below it.
const BLEND: u32 = 1 << 31;

impl VertexBlends {
    /// How many old vertices one vertex is made of, at most. Of more, the heaviest stay.
    pub const MAX_SOURCES: usize = 8;

    /// Old vertices that stay as they are, from 0 on.
    pub fn identity(count: u32) -> Self {
        Self {
            of: (0..count.min(BLEND)).collect(),
            ..Self::default()
        }
    }

    /// How many vertices there are.
    pub fn len(&self) -> usize {
        self.of.len()
    }

    /// Whether there is no vertex.
    pub fn is_empty(&self) -> bool {
        self.of.is_empty()
    }

    /// Adds an old vertex that stays as it is.
    pub fn push_vertex(&mut self, vertex: u32) {
        if vertex < BLEND {
            self.of.push(vertex);
        } else {
            // No base has so many vertices, so writing it is refused, as for any vertex that does not exist.
            self.of.push(BLEND - 1);
        }
    }

    /// Adds a vertex blended from old ones. Entries of the same vertex are summed, those without weight dropped, at most
    /// [`VertexBlends::MAX_SOURCES`] kept, and the weights scaled to a sum of 1. Without any weight it is its first entry unchanged.
    pub fn push_blend(&mut self, entries: &[(u32, f64)]) {
        let mut summed: Vec<(u32, f64)> = entries.to_vec();
        sum_by_vertex(&mut summed);
        summed.retain(|(_, weight)| *weight > 0.0 && weight.is_finite());
        summed.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        summed.truncate(Self::MAX_SOURCES);
        let total: f64 = summed.iter().map(|(_, weight)| weight).sum();
        // A weight that is nothing beside the others would only cost space.
        summed.retain(|(_, weight)| *weight / total > 1e-7);
        let blends = self.starts.len();
        match summed.as_slice() {
            [] => self.push_vertex(entries.first().map_or(BLEND - 1, |e| e.0)),
            [(vertex, _)] => self.push_vertex(*vertex),
            many if blends < BLEND as usize && u32::try_from(self.entries.len()).is_ok() => {
                self.of.push(BLEND | blends as u32);
                self.starts.push(self.entries.len() as u32);
                self.entries.extend(many.iter().map(|&(v, w)| (v, (w / total) as f32)));
            }
            [(vertex, _), ..] => self.push_vertex(*vertex),
        }
    }

    /// Adds a vertex made of vertices of an edited model with these blends: `parts` names them with their weights.
    pub fn push_composed(&mut self, earlier: &Self, parts: &[(u32, f64)]) {
        if let [(one, _)] = parts
            && let Some(VertexBlend::Vertex(vertex)) = earlier.get(*one as usize)
        {
            return self.push_vertex(vertex);
        }
        let mut entries = Vec::with_capacity(parts.len() * 2);
        for &(part, share) in parts.iter().filter(|(_, share)| *share != 0.0) {
            let blend = earlier.get(part as usize).unwrap_or(VertexBlend::Vertex(BLEND - 1));
            entries.extend(blend.iter().map(|(vertex, weight)| (vertex, weight * share)));
        }
        self.push_blend(&entries);
    }

    /// The blend of a vertex; `None` past the last.
    pub fn get(&self, vertex: usize) -> Option<VertexBlend<'_>> {
        let of = *self.of.get(vertex)?;
        if of < BLEND {
            return Some(VertexBlend::Vertex(of));
        }
        let blend = (of - BLEND) as usize;
        let start = *self.starts.get(blend)? as usize;
        let end = self
            .starts
            .get(blend + 1)
            .map_or(self.entries.len(), |&end| end as usize);
        self.entries.get(start..end).map(VertexBlend::Blend)
    }

    /// About how many bytes it holds in memory.
    pub fn bytes_held(&self) -> u64 {
        let lists = size_of_val(self.of.as_slice())
            + size_of_val(self.starts.as_slice())
            + size_of_val(self.entries.as_slice());
        lists as u64
    }
}

/// Sums the weights of each vertex, in the order of vertices.
pub(super) fn sum_by_vertex(weights: &mut Vec<(u32, f64)>) {
    weights.sort_by_key(|&(vertex, _)| vertex);
    weights.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        kept.1 += if same { next.1 } else { 0.0 };
        same
    });
}

/// What one vertex is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum VertexBlend<'a> {
    /// An old vertex, unchanged.
    Vertex(u32),
    /// Old vertices, heaviest first, and their weights, which sum to 1.
    Blend(&'a [(u32, f32)]),
}

impl<'a> VertexBlend<'a> {
    /// The old vertices with their weights, heaviest first.
    pub fn iter(self) -> impl Iterator<Item = (u32, f64)> + 'a {
        let (one, many) = match self {
            Self::Vertex(vertex) => (Some((vertex, 1.0)), &[][..]),
            Self::Blend(entries) => (None, entries),
        };
        one.into_iter()
            .chain(many.iter().map(|&(vertex, weight)| (vertex, f64::from(weight))))
    }

    /// The old vertex that weighs most.
    pub fn heaviest(self) -> u32 {
        match self {
            Self::Vertex(vertex) => vertex,
            Self::Blend(entries) => entries.first().map_or(BLEND - 1, |e| e.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(blends: &VertexBlends, vertex: usize) -> Vec<(u32, f64)> {
        blends.get(vertex).expect("there").iter().collect()
    }

    #[test]
    fn blends_are_summed_scaled_and_cut_to_the_heaviest() {
        let mut blends = VertexBlends::identity(2);
        blends.push_blend(&[(5, 1.0), (3, 0.5), (5, 0.5), (9, 0.0)]);
        assert_eq!(list(&blends, 1), [(1, 1.0)]);
        assert_eq!(list(&blends, 2), [(5, 0.75), (3, 0.25)]);
        let many: Vec<(u32, f64)> = (0..20).map(|i| (i, 1.0 + f64::from(i))).collect();
        blends.push_blend(&many);
        let kept = list(&blends, 3);
        assert_eq!(
            kept.iter().map(|e| e.0).collect::<Vec<_>>(),
            (12..20).rev().collect::<Vec<_>>()
        );
        assert!((kept.iter().map(|e| e.1).sum::<f64>() - 1.0).abs() < 1e-6);
        blends.push_blend(&[(7, 2.0), (8, 1e-12)]);
        assert_eq!(blends.get(4), Some(VertexBlend::Vertex(7)));
        blends.push_blend(&[(6, 0.0)]);
        assert_eq!((blends.get(5), blends.get(6)), (Some(VertexBlend::Vertex(6)), None));
    }

    #[test]
    fn a_blend_of_blends_names_the_oldest_vertices() {
        let mut first = VertexBlends::identity(4);
        first.push_blend(&[(0, 0.5), (1, 0.5)]);
        let mut second = VertexBlends::default();
        second.push_composed(&first, &[(2, 1.0)]);
        second.push_composed(&first, &[(4, 1.0)]);
        second.push_composed(&first, &[(4, 0.5), (1, 0.25), (3, 0.25)]);
        assert_eq!(list(&second, 0), [(2, 1.0)]);
        assert_eq!(list(&second, 1), [(0, 0.5), (1, 0.5)]);
        assert_eq!(list(&second, 2), [(1, 0.5), (0, 0.25), (3, 0.25)]);
    }
}
