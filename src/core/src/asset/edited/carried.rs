//! How normals and tangents follow an edit and the deformations around it.

use super::{EditedModel, PrimitiveRun, VertexBlend};
use crate::asset::geometry::unit_or_zero;
use crate::mesh::shading;
use glam::{DMat3, DVec3, Vec3, Vec4};

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
