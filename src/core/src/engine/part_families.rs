//! Which parts of a model were one: pieces that an edit has separated are not tied to each other again.
//!
//! What the vertices of an edited model are made of, so that attributes can be read from the files they came in when the
//! model is written.

use crate::asset::{
    self, BaseModel, CapLooks, EditedModel, Format, Model, Primitive, PrimitiveRun, ShapeFollowers, VertexBlend,
    VertexBlends, WrittenFiles, write_edited_model_following,
};
use crate::deform::TieFamilies;
use crate::edit::{PatchedSurface, SurfacePatch, SurfaceView};
use crate::engine::cap_coordinates::cap_uv_after_edit;
use crate::engine::error::Error;
use crate::engine::riding::number_of_primitives;
use crate::engine::settings::KeptApart;
use crate::graph::LOOSE;
use crate::mesh::{Components, Mesh, NONE};
use glam::{DAffine3, DVec3};
use std::sync::Arc;

/// The family of each point of a model. A connected part is of one family; so are the pieces that a cut makes of it, and
/// what an edit joins.
#[derive(Debug, Clone, Default)]
pub(super) struct PartFamilies {
    /// By point, or [`LOOSE`] on parts that get no ties; `None` where there is one family only.
    of_point: Option<Arc<Vec<u32>>>,
}

impl PartFamilies {
    /// Those of a model that no edit has touched: each part is a family, but for those to be kept apart.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a primitive or part that there is not.
    pub fn of_model(
        mesh: &Mesh,
        parts: &Components,
        primitives: &[Primitive],
        kept_apart: &KeptApart,
    ) -> Result<Self, Error> {
        let loose = loose_parts(mesh, parts, primitives, kept_apart)?;
        if parts.count < 2 {
            return Ok(Self::default());
        }
        let family = |&part: &u32| if loose[part as usize] { LOOSE } else { part };
        Ok(Self {
            of_point: Some(Arc::new(parts.of_vertex.iter().map(family).collect())),
        })
    }

    /// Those after an edit of `before`, whose first `points` are those of this value.
    pub fn after_edit(
        &self,
        points: usize,
        before: &SurfaceView<'_>,
        applied: &PatchedSurface,
        patch: &SurfacePatch,
    ) -> Self {
        let merged = before.points as usize > points;
        if self.of_point.is_none() && !merged {
            return self.clone();
        }
        let known = self
            .of_point
            .as_ref()
            .map_or_else(|| vec![0; points], |f| f.as_ref().clone());
        let known = with_merged_parts(known, before);
        let old = before.positions.len();
        // Of a render vertex after the edit the family before it: its own, or that of what it is blended from.
        let family_before = |v: usize| {
            let was = applied.old_from_vertex[v] as usize;
            let source = match was.checked_sub(old) {
                None => was,
                Some(new) => {
                    let new = patch.vertices.get(new)?;
                    let heaviest = (0..3).reduce(|a, b| if new.weights[b] > new.weights[a] { b } else { a })?;
                    new.of[heaviest] as usize
                }
            };
            let point = *before.point_of.get(source)?;
            known.get(point as usize).copied().map(|family| (family, was < old))
        };
        let mut met: Vec<(u32, u32, bool)> = Vec::new();
        let corner = |v: &u32| applied.point_of[*v as usize];
        let triangles: Vec<[u32; 3]> = applied
            .triangles
            .iter()
            .map(|t| [0, 1, 2].map(|k| corner(&t[k])))
            .collect();
        let parts = Components::of_triangles(applied.points as usize, &triangles);
        for (v, &point) in applied.point_of.iter().enumerate().filter(|p| *p.1 != NONE) {
            if let Some((family, own)) = family_before(v) {
                met.push((parts.of_vertex[point as usize], family, own));
            }
        }
        met.sort_unstable();
        met.dedup();
        Self::joined_by_parts(&parts, &met)
    }

    /// One family for all that some part has vertices of. `met` has parts with the families of their vertices, sorted, and
    /// whether they are old vertices; those of new ones count where a part has no others.
    fn joined_by_parts(parts: &Components, met: &[(u32, u32, bool)]) -> Self {
        let families = met
            .iter()
            .map(|m| m.1)
            .filter(|f| *f != LOOSE)
            .max()
            .map_or(0, |f| f as usize + 1);
        // The last one stands for what is kept apart.
        let index = |family: u32| if family == LOOSE { families as u32 } else { family };
        let mut first = vec![NONE; parts.count];
        let mut same: Vec<(u32, u32)> = Vec::new();
        for own in [true, false] {
            let whole = first.clone();
            for &(part, family, _) in met
                .iter()
                .filter(|m| m.2 == own && (own || whole[m.0 as usize] == NONE))
            {
                let first = &mut first[part as usize];
                if *first == NONE {
                    *first = index(family);
                } else {
                    same.push((*first, index(family)));
                }
            }
        }
        let sets = Components::of_edges(families + 1, same.into_iter());
        let loose = sets.of_vertex[families];
        let family = |&part: &u32| match first[part as usize] {
            NONE => LOOSE,
            f if sets.of_vertex[f as usize] == loose => LOOSE,
            f => sets.of_vertex[f as usize],
        };
        let of_point: Vec<u32> = parts.of_vertex.iter().map(family).collect();
        let several = of_point.windows(2).any(|pair| pair[0] != pair[1]);
        Self {
            of_point: several.then(|| Arc::new(of_point)),
        }
    }

    /// As the body takes them.
    pub fn tie_families(&self) -> TieFamilies {
        self.of_point.clone().map_or(TieFamilies::One, TieFamilies::Of)
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.of_point.as_ref().map_or(0, |f| 4 * f.capacity() as u64)
    }
}

/// Appends families of their own for the parts that an edit brings in.
fn with_merged_parts(mut known: Vec<u32>, before: &SurfaceView<'_>) -> Vec<u32> {
    let first = known.len();
    let points = before.points as usize;
    if points <= first {
        return known;
    }
    let next = known.iter().filter(|f| **f != LOOSE).max().map_or(0, |f| f + 1);
    let triangles: Vec<[u32; 3]> = before
        .triangles
        .iter()
        .map(|t| t.map(|v| before.point_of[v as usize]))
        .filter(|t| t[0] as usize >= first)
        .map(|t| t.map(|p| p - first as u32))
        .collect();
    let parts = Components::of_triangles(points - first, &triangles);
    known.extend(parts.of_vertex.iter().map(|part| next + part));
    known
}

/// Which parts get no ties.
fn loose_parts(
    mesh: &Mesh,
    parts: &Components,
    primitives: &[Primitive],
    kept_apart: &KeptApart,
) -> Result<Vec<bool>, Error> {
    let mut loose = vec![false; parts.count];
    for (k, &part) in kept_apart.components.iter().enumerate() {
        let Some(loose) = loose.get_mut(part as usize) else {
            let problem = format!(
                "is {part}, the model has {} connected parts, counted from 0",
                parts.count
            );
            return Err(Error::invalid(format!("keepApart.components[{k}]"), problem));
        };
        *loose = true;
    }
    for (k, &primitive) in kept_apart.primitives.iter().enumerate() {
        let Some(primitive) = primitives.get(primitive as usize) else {
            let problem = format!(
                "is {primitive}, the model has {}, counted from 0",
                number_of_primitives(primitives.len())
            );
            return Err(Error::invalid(format!("keepApart.primitives[{k}]"), problem));
        };
        for v in primitive.vertices() {
            if let Some(&point) = mesh.solver_from_render.get(v).filter(|p| **p != NONE) {
                loose[parts.of_vertex[point as usize] as usize] = true;
            }
        }
    }
    Ok(loose)
}

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
    /// Of each primitive that is a cap with a material of its own, the material's name.
    cap_materials: Vec<Option<Arc<str>>>,
    /// The texture coordinates of each vertex of a cap; empty while there is none.
    cap_uv: Vec<[f32; 2]>,
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
            cap_materials: Vec::new(),
            cap_uv: Vec::new(),
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
        self.cap_materials.resize(self.sources.len(), None);
        if !self.cap_uv.is_empty() {
            self.cap_uv.resize(self.blends.len(), [0.0; 2]);
        }
        self.triangles.extend(source_triangle);
        self.bases.push((Arc::clone(model), placement));
    }

    /// Appends a primitive without vertices: a cap whose vertices are blended from those of the primitive `lender`.
    pub fn add_cap(&mut self, lender: u32, material: &str) {
        self.sources.push(self.sources[lender as usize]);
        self.cap_materials.push(Some(material.into()));
        self.cap_uv.resize(self.blends.len(), [0.0; 2]);
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
                    let slid = patch.blended.binary_search_by_key(&was, |b| b.vertex);
                    let slid = slid.ok().map(|k| &patch.blended[k]);
                    match slid {
                        Some(slid) => blends.push_composed(&self.blends, &slid.parts().collect::<Vec<_>>()),
                        None => blends.push_composed(&self.blends, &[(was, 1.0)]),
                    }
                    flags.push(self.bare[was as usize] || slid.is_some_and(|slid| slid.flat));
                }
                Some(new) => {
                    let parts: Vec<(u32, f64)> = new.parts().collect();
                    blends.push_composed(&self.blends, &parts);
                    let inherited = parts.iter().all(|p| self.bare[p.0 as usize]);
                    flags.push(inherited || bare(now));
                }
            }
        }
        let was = |t: &u32| self.triangles.get(*t as usize).copied().unwrap_or(NONE);
        Self {
            cap_uv: cap_uv_after_edit(&self.cap_uv, applied, patch),
            cap_materials: self.cap_materials.clone(),
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
        geometry: &asset::Geometry,
        positions: &[DVec3],
        format: Format,
        followers: &ShapeFollowers<'_>,
    ) -> Result<WrittenFiles, asset::Error> {
        self.described(geometry, |edited| {
            write_edited_model_following(edited, positions, format, followers.clone())
        })
    }

    /// The segments of the model's lines, by its vertices. `geometry` has its primitives and triangles.
    pub fn line_segments(&self, geometry: &asset::Geometry) -> Result<Vec<[u32; 2]>, asset::Error> {
        self.described(geometry, asset::line_segments)
    }

    /// Describes the edited model to `take`.
    fn described<T>(&self, geometry: &asset::Geometry, take: impl FnOnce(&EditedModel<'_>) -> T) -> T {
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
        take(&EditedModel {
            bases: &bases,
            runs: &runs,
            blends: &self.blends,
            triangles: &geometry.triangles,
            origins: &self.triangles,
            bare: &self.bare,
            caps: CapLooks {
                materials: &self.cap_materials,
                uv: &self.cap_uv,
            },
        })
    }

    /// Bytes held, with those of the models that were merged in.
    pub fn byte_size(&self) -> u64 {
        let merged: u64 = self.bases.iter().skip(1).map(|(model, _)| model.bytes_held()).sum();
        self.blends.bytes_held()
            + (self.bare.capacity() + 4 * self.triangles.capacity() + 8 * self.cap_uv.capacity()) as u64
            + merged
    }
}
