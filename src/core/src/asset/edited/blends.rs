//! What the vertices of an edited model are made of: old vertices and weights; and how normals and tangents follow.

use super::{EditedModel, PrimitiveRun};
use crate::asset::geometry::unit_or_zero;
use crate::mesh::shading;
use glam::{DMat3, DVec3, Vec3, Vec4};

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
        summed.sort_by_key(|&(vertex, _)| vertex);
        summed.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            kept.1 += if same { next.1 } else { 0.0 };
            same
        });
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

/// One run's shape before and after, and the directions that follow.
///
/// *Before* is where the blends put the vertices among their base's, as placed; *after* is where they are now. Between
/// both lie all edits and all deformations, so that one gradient per vertex carries what an artist authored to where it
/// belongs.
pub(in crate::asset) struct CarriedAttributes<'a> {
    edited: &'a EditedModel<'a>,
    run: &'a PrimitiveRun,
    /// Where the run's vertices are now.
    now: &'a [DVec3],
    /// Triangles over the run's vertices.
    pub triangles: Vec<[u32; 3]>,
    gradients: Vec<Option<DMat3>>,
    /// Normals of the surface as it is now; made when first needed.
    smooth: std::cell::OnceCell<Vec<Vec3>>,
}

impl<'a> CarriedAttributes<'a> {
    /// `positions` are those of the whole edited model.
    pub fn new(edited: &'a EditedModel<'a>, run: &'a PrimitiveRun, positions: &'a [DVec3]) -> Self {
        let triangles = edited.local_triangles(run);
        let now = &positions[run.vertices()];
        let before = Self::before(edited, run);
        let gradients = shading::gradients(&before, now, &triangles, &triangles, now.len());
        Self {
            edited,
            run,
            now,
            triangles,
            gradients,
            smooth: std::cell::OnceCell::new(),
        }
    }

    /// Where the blends put a run's vertices.
    pub fn before(edited: &EditedModel<'_>, run: &PrimitiveRun) -> Vec<DVec3> {
        let base = edited.base(run);
        let place = |vertex: usize| {
            let old = &base.model.geometry.positions;
            let blend = edited.blend(vertex);
            let here = match blend {
                VertexBlend::Vertex(vertex) => old[vertex as usize],
                _ => blend.iter().map(|(v, weight)| old[v as usize] * weight).sum(),
            };
            base.world_from_model.transform_point3(here)
        };
        run.vertices().map(place).collect()
    }

    fn smooth(&self, i: usize) -> Vec3 {
        self.smooth
            .get_or_init(|| shading::smooth_normals(self.now, &self.triangles))
            .get(i)
            .copied()
            .unwrap_or(Vec3::Z)
    }

    /// The unit normals of the run's vertices in world space.
    pub fn normals(&self) -> Vec<Vec3> {
        let base = self.edited.base(self.run);
        let old = &base.model.geometry.normals;
        let world_from_normal = shading::cofactor(&base.world_from_model.matrix3);
        let turned = base.world_from_model.matrix3 != DMat3::IDENTITY;
        let sign = if base.world_from_model.matrix3.determinant() < 0.0 {
            -1.0
        } else {
            1.0
        };
        let one = |(i, vertex): (usize, usize)| {
            if self.edited.is_bare(vertex) {
                return self.smooth(i);
            }
            let normal = match self.edited.blend(vertex) {
                VertexBlend::Vertex(v) => old.get(v as usize).copied().unwrap_or(Vec3::ZERO),
                blend => {
                    let of = |v: u32| old.get(v as usize).copied().unwrap_or(Vec3::ZERO).as_dvec3();
                    unit_or_zero(blend.iter().map(|(v, weight)| of(v) * weight).sum())
                }
            };
            let placed = if turned {
                unit_or_zero(world_from_normal * normal.as_dvec3() * sign)
            } else {
                normal
            };
            if placed == Vec3::ZERO {
                return self.smooth(i);
            }
            self.gradients[i]
                .as_ref()
                .map_or(placed, |g| shading::carry_normal(g, placed))
        };
        self.run.vertices().enumerate().map(one).collect()
    }

    /// The unit tangents of the run's vertices in world space, orthogonal to `normals`.
    pub fn tangents(&self, normals: &[Vec3]) -> Vec<Vec4> {
        let base = self.edited.base(self.run);
        let old = &base.model.geometry.tangents;
        let matrix = base.world_from_model.matrix3;
        let side = if matrix.determinant() < 0.0 { -1.0 } else { 1.0 };
        let of = |v: u32| old.get(v as usize).copied().unwrap_or(Vec4::ZERO);
        let one = |(i, vertex): (usize, usize)| {
            let blend = self.edited.blend(vertex);
            let normal = normals[i];
            // A mean of both sides is none; the heaviest vertex says on which side the bitangent lies.
            let w = if of(blend.heaviest()).w < 0.0 { -side } else { side };
            let tangent: DVec3 = blend
                .iter()
                .map(|(v, weight)| of(v).truncate().as_dvec3() * weight)
                .sum();
            let placed = unit_or_zero(matrix * tangent);
            let across = || normal.any_orthonormal_vector().extend(w);
            if placed == Vec3::ZERO || self.edited.is_bare(vertex) {
                return across();
            }
            match (&self.gradients[i], blend) {
                (Some(gradient), _) => shading::carry_tangent(gradient, placed.extend(w), normal),
                (None, VertexBlend::Vertex(_)) => placed.extend(w),
                (None, _) => (placed - normal * normal.dot(placed))
                    .try_normalize()
                    .map_or_else(across, |t| t.extend(w)),
            }
        };
        self.run.vertices().enumerate().map(one).collect()
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
