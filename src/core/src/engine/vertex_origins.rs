//! What the vertices of an edited model are made of, so that attributes can be read from the files they came in when the
//! model is written.

use crate::asset::{
    BaseModel, EditedModel, Error, Format, Model, PrimitiveRun, ShapeFollowers, VertexBlend, VertexBlends,
    WrittenFiles, write_edited_model_following,
};
use crate::edit::{PatchedSurface, SurfacePatch};
use crate::mesh::NONE;
use glam::{DAffine3, DVec3};
use std::sync::Arc;

/// A primitive of an edited model: which primitive of which base it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PrimitiveOrigin {
    base: u32,
    primitive: u32,
}

/// The blends of all render vertices, and the models that they refer to.
#[derive(Debug, Clone)]
pub(super) struct VertexOrigins {
    /// The uploaded model first, then those that were merged in, with their places.
    bases: Vec<(Arc<Model>, DAffine3)>,
    /// Of each primitive.
    sources: Vec<PrimitiveOrigin>,
    /// Of each render vertex, over the vertices of its primitive's base.
    blends: VertexBlends,
    /// Whether a vertex lies on surface that an edit has made.
    bare: Vec<bool>,
    /// The triangle of the base that each triangle was.
    triangles: Vec<u32>,
}

impl VertexOrigins {
    /// Those of a model that no edit has touched, of whose triangles `source_triangle` are left.
    pub fn of_model(model: &Arc<Model>, source_triangle: &[u32]) -> Self {
        let mut origins = Self {
            bases: Vec::new(),
            sources: Vec::new(),
            blends: VertexBlends::default(),
            bare: Vec::new(),
            triangles: Vec::new(),
        };
        origins.append(model, DAffine3::IDENTITY, source_triangle);
        origins
    }

    /// Appends a whole model: its vertices and primitives after those that are there.
    pub fn append(&mut self, model: &Arc<Model>, placement: DAffine3, source_triangle: &[u32]) {
        let base = self.bases.len() as u32;
        let primitives = 0..model.primitives.len() as u32;
        self.sources
            .extend(primitives.map(|primitive| PrimitiveOrigin { base, primitive }));
        (0..model.positions.len() as u32).for_each(|v| self.blends.push_vertex(v));
        self.bare.resize(self.blends.len(), false);
        self.triangles.extend(source_triangle);
        self.bases.push((Arc::clone(model), placement));
    }

    /// The models that vertices come from.
    pub fn models(&self) -> impl Iterator<Item = &Arc<Model>> {
        self.bases.iter().map(|base| &base.0)
    }

    /// Which of them a primitive comes from.
    pub fn base_of_primitive(&self, primitive: u32) -> usize {
        self.sources[primitive as usize].base as usize
    }

    /// What a vertex is made of, among the vertices of its primitive's model.
    pub fn blend(&self, vertex: u32) -> Option<VertexBlend<'_>> {
        self.blends.get(vertex as usize)
    }

    /// Whether a vertex lies on surface that an edit has made.
    pub fn is_bare(&self, vertex: u32) -> bool {
        self.bare.get(vertex as usize).copied().unwrap_or(false)
    }

    /// Whether any does.
    pub fn has_bare(&self) -> bool {
        self.bare.contains(&true)
    }

    /// The same with the triangles of these numbers alone.
    pub fn with_triangles(&self, numbers: &[u32]) -> Self {
        Self {
            triangles: numbers.iter().map(|&t| self.base_triangle(t as usize)).collect(),
            ..self.clone()
        }
    }

    /// The triangle of its base that a triangle was; [`NONE`] for one that an edit has made.
    pub fn base_triangle(&self, triangle: usize) -> u32 {
        self.triangles.get(triangle).copied().unwrap_or(NONE)
    }

    /// Sets which triangle of its base each triangle was.
    pub fn set_triangles(&mut self, was: Vec<u32>) {
        self.triangles = was;
    }

    /// What the vertices are made of after an edit. `bare`: whether a new vertex is on a surface that the edit made.
    pub fn after_edit(&self, applied: &PatchedSurface, patch: &SurfacePatch, bare: impl Fn(usize) -> bool) -> Self {
        let old = self.blends.len();
        let mut blends = VertexBlends::default();
        let mut flags = Vec::with_capacity(applied.old_from_vertex.len());
        for (now, &was) in applied.old_from_vertex.iter().enumerate() {
            match (was as usize).checked_sub(old).and_then(|k| patch.vertices.get(k)) {
                None => {
                    blends.push_composed(&self.blends, &[(was, 1.0)]);
                    flags.push(self.bare[was as usize]);
                }
                Some(new) => {
                    let parts = new.of.into_iter().zip(new.weights).filter(|p| p.1 > 0.0);
                    let parts: Vec<(u32, f64)> = parts.collect();
                    blends.push_composed(&self.blends, &parts);
                    let inherited = parts.iter().all(|p| self.bare[p.0 as usize]);
                    flags.push(inherited || bare(now));
                }
            }
        }
        let was = |t: &u32| self.triangles.get(*t as usize).copied().unwrap_or(NONE);
        Self {
            bases: self.bases.clone(),
            sources: self.sources.clone(),
            blends,
            bare: flags,
            triangles: applied.old_from_triangle.iter().map(was).collect(),
        }
    }

    /// The edited model as files. `geometry` has its primitives and triangles.
    pub fn write(
        &self,
        geometry: &crate::asset::Geometry,
        positions: &[DVec3],
        format: Format,
        followers: &ShapeFollowers<'_>,
    ) -> Result<WrittenFiles, Error> {
        let bases: Vec<BaseModel<'_>> = (self.bases.iter())
            .map(|(model, placement)| BaseModel {
                model,
                world_from_model: *placement,
            })
            .collect();
        let mut first_triangle = 0;
        let runs: Vec<PrimitiveRun> = (self.sources.iter().zip(&geometry.primitives))
            .map(|(source, p)| {
                let run = PrimitiveRun {
                    base: source.base,
                    primitive: source.primitive,
                    first_vertex: p.first_vertex,
                    vertex_count: p.vertex_count,
                    first_triangle,
                    triangle_count: p.index_count / 3,
                };
                first_triangle += run.triangle_count;
                run
            })
            .collect();
        let edited = EditedModel {
            bases: &bases,
            runs: &runs,
            blends: &self.blends,
            triangles: &geometry.triangles,
            origins: &self.triangles,
            bare: &self.bare,
        };
        write_edited_model_following(&edited, positions, format, followers.clone())
    }

    /// Bytes held, with those of the models that were merged in.
    pub fn byte_size(&self) -> u64 {
        let merged: u64 = self.bases.iter().skip(1).map(|(model, _)| model.bytes_held()).sum();
        self.blends.bytes_held() + (self.bare.capacity() + 4 * self.triangles.capacity()) as u64 + merged
    }
}
