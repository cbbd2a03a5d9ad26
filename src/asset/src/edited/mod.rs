//! A model whose triangles an edit has changed: what its vertices are made of.
//!
//! An edited model is described, not stored: which old vertices each of its vertices is blended from ([`VertexBlends`]),
//! and its triangles. Texture coordinates, colours, skin weights, morph targets and whatever else the uploaded files hold
//! are read from those files when the model is written, blended, and forgotten again.
//!
//! Owns the description, its check, and how attributes follow: normals and tangents, what belongs to corners of faces,
//! and which polygons still stand ([`origins`]). The codecs write the files.

mod blends;
mod lines;
mod origins;

pub use blends::{VertexBlend, VertexBlends};
pub(super) use lines::{FollowedLines, segments_of};
pub(super) use origins::{CarriedAttributes, FaceOutlines, RunFaces, TriangleOrigins};

use super::model::FileNotes;
use super::{Error, Format, Model, Primitive};
use glam::{DAffine3, DVec3};
use std::ops::Range;
use std::sync::Arc;

/// A model that vertices come from.
#[derive(Debug, Clone, Copy)]
pub struct BaseModel<'a> {
    /// The model as uploaded.
    pub model: &'a Model,
    /// Where it was put: the identity for the session's own model.
    pub world_from_model: DAffine3,
}

/// A run of vertices and triangles that belong to one primitive of one base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PrimitiveRun {
    /// Index of the base.
    pub base: u32,
    /// Index in the base's primitive table.
    pub primitive: u32,
    /// Its first vertex.
    pub first_vertex: u32,
    /// Number of its vertices.
    pub vertex_count: u32,
    /// Its first triangle.
    pub first_triangle: u32,
    /// Number of its triangles; 0 when the edit took all of them.
    pub triangle_count: u32,
}

impl PrimitiveRun {
    /// Its vertices.
    pub fn vertices(&self) -> Range<usize> {
        self.first_vertex as usize..(self.first_vertex as usize).saturating_add(self.vertex_count as usize)
    }

    /// Its triangles.
    pub fn triangles(&self) -> Range<usize> {
        self.first_triangle as usize..(self.first_triangle as usize).saturating_add(self.triangle_count as usize)
    }
}

/// A model after edits of its topology.
#[derive(Debug, Clone, Copy)]
pub struct EditedModel<'a> {
    /// The models that vertices come from: the session's own first, then those merged into it. A primitive of a base
    /// that no run names is gone.
    pub bases: &'a [BaseModel<'a>],
    /// Who owns which vertices and triangles: runs follow each other without gaps, in vertices and in triangles.
    pub runs: &'a [PrimitiveRun],
    /// What each vertex is made of: render vertices of its run's primitive, numbered as in its base.
    pub blends: &'a VertexBlends,
    /// Triangles over the vertices, each within its run.
    pub triangles: &'a [[u32; 3]],
    /// For each triangle the triangle of the base that it is a part of or lies on, [`NONE`](pliant_mesh::NONE) where
    /// that is not known. Empty when it is known of none: the triangle that shares most of the blends is then taken.
    pub origins: &'a [u32],
    /// For each vertex whether its surface is the edit's own (a cap, a filled hole) or shaded flat, so that normals and
    /// tangents are taken from the triangles instead of from the blend. Empty when there is no such vertex.
    pub bare: &'a [bool],
    /// What runs look like that are caps with a material of their own.
    pub caps: CapLooks<'a>,
}

/// Surface that edits have made, with a material and texture coordinates of its own: skin weights and morph targets alone are those
/// of the primitive that its run names.
#[derive(Debug, Clone, Copy, Default)]
pub struct CapLooks<'a> {
    /// For each run the name of its material when it is a cap. Empty when none is.
    pub materials: &'a [Option<Arc<str>>],
    /// Texture coordinates of each vertex, as in glTF; those of vertices of other runs mean nothing. Empty when no run is a
    /// cap.
    pub uv: &'a [[f32; 2]],
}

impl<'a> EditedModel<'a> {
    /// What `read` finds in each base whose format's reader has left notes of this type; `None` for other bases.
    pub(super) fn read_bases<N: FileNotes, T>(
        &self,
        read: impl Fn(&'a Model, &'a N) -> Result<T, Error>,
    ) -> Result<Vec<Option<T>>, Error> {
        let one = |base: &BaseModel<'a>| base.model.notes().map(|notes| read(base.model, notes)).transpose();
        self.bases.iter().map(one).collect()
    }

    /// The runs of a base that have triangles.
    pub(super) fn runs_with_triangles(&self, base: u32) -> impl Iterator<Item = &'a PrimitiveRun> + use<'a> {
        let runs = self.runs.iter();
        runs.filter(move |run| run.base == base && run.triangle_count > 0)
    }

    /// Whether a run draws something: triangles, or points and lines, which never had any, as far as they are left.
    pub(super) fn is_drawn(&self, run: &PrimitiveRun) -> bool {
        run.triangle_count > 0 || (run.vertex_count > 0 && self.primitive(run).index_count == 0)
    }

    /// The base of a run. Checked by [`check`].
    pub(super) fn base(&self, run: &PrimitiveRun) -> &BaseModel<'a> {
        &self.bases[run.base as usize]
    }

    /// The primitive of a run. Checked by [`check`].
    pub(super) fn primitive(&self, run: &PrimitiveRun) -> &'a Primitive {
        &self.bases[run.base as usize].model.geometry.primitives[run.primitive as usize]
    }

    /// The triangles of a run over its own vertices, counted from 0.
    pub(super) fn local_triangles(&self, run: &PrimitiveRun) -> Vec<[u32; 3]> {
        let triangles = self.triangles[run.triangles()].iter();
        triangles.map(|t| t.map(|v| v - run.first_vertex)).collect()
    }

    /// The blend of a vertex. Checked by [`check`].
    pub(super) fn blend(&self, vertex: usize) -> VertexBlend<'a> {
        self.blends.get(vertex).unwrap_or(VertexBlend::Blend(&[]))
    }

    /// A number of a vertex, blended from those that `number_of` gives for old vertices.
    pub(super) fn blended(&self, vertex: usize, number_of: impl Fn(u32) -> f64) -> f64 {
        self.blend(vertex)
            .iter()
            .map(|(old, weight)| number_of(old) * weight)
            .sum()
    }

    /// The name of the material of a run that is a cap.
    pub(super) fn cap_material(&self, run: &PrimitiveRun) -> Option<&'a str> {
        let place = self.runs.iter().position(|other| other == run)?;
        self.caps.materials.get(place)?.as_deref()
    }

    /// The names of the materials of caps, each once.
    pub(super) fn cap_materials(&self) -> Vec<&'a str> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.caps.materials.iter().flatten() {
            if !names.contains(&&**name) {
                names.push(name);
            }
        }
        names
    }

    /// The place of the material of a run among those of caps.
    pub(super) fn cap_number(&self, run: &PrimitiveRun) -> Option<usize> {
        let own = self.cap_material(run)?;
        self.cap_materials().iter().position(|name| *name == own)
    }

    /// The texture coordinates of a run that is a cap.
    pub(super) fn cap_uv(&self, run: &PrimitiveRun) -> &'a [[f32; 2]] {
        self.caps.uv.get(run.vertices()).unwrap_or(&[])
    }

    /// Whether the normal of a vertex comes from its triangles.
    pub(super) fn is_bare(&self, vertex: usize) -> bool {
        self.bare.get(vertex).copied().unwrap_or(false)
    }

    /// Whether a run has its primitive's vertices and triangles, each where it was. `old` are the primitive's triangles.
    pub(super) fn is_untouched(&self, run: &PrimitiveRun, old: &[[u32; 3]]) -> bool {
        let primitive = self.primitive(run);
        let shift = |t: &[u32; 3]| t.map(|v| v - run.first_vertex + primitive.first_vertex);
        primitive.vertex_count == run.vertex_count
            && self.cap_material(run).is_none()
            && old.len() == run.triangle_count as usize
            && run
                .vertices()
                .zip(primitive.first_vertex..)
                .all(|(v, old)| self.blend(v) == VertexBlend::Vertex(old) && !self.is_bare(v))
            && self.triangles[run.triangles()]
                .iter()
                .map(shift)
                .eq(old.iter().copied())
    }
}

/// Hands out a model as an edit would leave it that keeps every vertex and triangle.
pub(crate) fn with_whole_model<T>(model: &Model, work: impl FnOnce(&EditedModel<'_>) -> T) -> T {
    let geometry = &model.geometry;
    let mut first_triangle = 0;
    let mut runs = Vec::with_capacity(geometry.primitives.len());
    for (i, primitive) in geometry.primitives.iter().enumerate() {
        let triangle_count = primitive.index_count / 3;
        runs.push(PrimitiveRun {
            base: 0,
            primitive: i as u32,
            first_vertex: primitive.first_vertex,
            vertex_count: primitive.vertex_count,
            first_triangle,
            triangle_count,
        });
        first_triangle += triangle_count;
    }
    let edited = EditedModel {
        bases: &[BaseModel {
            model,
            world_from_model: DAffine3::IDENTITY,
        }],
        runs: &runs,
        blends: &VertexBlends::identity(geometry.positions.len() as u32),
        triangles: &geometry.triangles,
        origins: &[],
        bare: &[],
        caps: CapLooks::default(),
    };
    work(&edited)
}

/// Checks everything about a description that the writers rely on.
pub(super) fn check(edited: &EditedModel<'_>, positions: &[DVec3], format: Format) -> Result<(), Error> {
    let wrong = |problem: String| Err(Error::unwritable(format, problem));
    let count = edited.blends.len();
    if positions.len() != count {
        let seen = positions.len();
        return wrong(format!("{seen} positions are given, the model has {count} vertices"));
    }
    if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
        return wrong(format!("the position of vertex {i} is {}, not finite", positions[i]));
    }
    if u32::try_from(count).is_err() || u32::try_from(edited.triangles.len()).is_err() {
        return wrong(format!("{count} vertices and {} triangles", edited.triangles.len()));
    }
    if edited.triangles.is_empty() {
        return wrong("no triangle is left".into());
    }
    for (what, length, wanted) in [
        ("origins", edited.origins.len(), edited.triangles.len()),
        ("marks of bare vertices", edited.bare.len(), count),
        ("texture coordinates of caps", edited.caps.uv.len(), count),
        ("materials of caps", edited.caps.materials.len(), edited.runs.len()),
    ] {
        if length != 0 && length != wanted {
            return wrong(format!("{length} {what} are given, {wanted} are needed, or none"));
        }
    }
    if let Some(i) = edited.bases.iter().position(|b| !b.world_from_model.is_finite()) {
        return wrong(format!("the transform of base {i} is not finite"));
    }
    let (mut vertex, mut triangle) = (0, 0);
    for (i, run) in edited.runs.iter().enumerate() {
        if run.first_vertex as usize != vertex || run.first_triangle as usize != triangle {
            return wrong(format!("run {i} does not begin where the one before it ends"));
        }
        (vertex, triangle) = (run.vertices().end, run.triangles().end);
        if vertex > count || triangle > edited.triangles.len() {
            return wrong(format!("run {i} reaches past the last vertex or triangle"));
        }
        let base = edited.bases.get(run.base as usize);
        let Some(primitive) = base.and_then(|b| b.model.geometry.primitives.get(run.primitive as usize)) else {
            return wrong(format!(
                "run {i}: primitive {} of base {} does not exist",
                run.primitive, run.base
            ));
        };
        check_run(edited, run, primitive).or_else(|problem| wrong(format!("run {i}: {problem}")))?;
    }
    if (vertex, triangle) != (count, edited.triangles.len()) {
        return wrong(format!("the runs end at vertex {vertex} and triangle {triangle}"));
    }
    Ok(())
}

fn check_run(edited: &EditedModel<'_>, run: &PrimitiveRun, primitive: &Primitive) -> Result<(), String> {
    let own = run.vertices();
    for (i, triangle) in edited.triangles[run.triangles()].iter().enumerate() {
        if triangle.iter().any(|&v| !own.contains(&(v as usize))) {
            return Err(format!(
                "triangle {i} has the corners {triangle:?}, its vertices are {own:?}"
            ));
        }
    }
    let old = u64::from(primitive.first_vertex)..u64::from(primitive.first_vertex) + u64::from(primitive.vertex_count);
    for vertex in own {
        let mut total = 0.0;
        for (of, weight) in edited.blend(vertex).iter() {
            if !old.contains(&u64::from(of)) {
                return Err(format!(
                    "vertex {vertex} is made of vertex {of}, the primitive has {old:?}"
                ));
            }
            if weight < 0.0 || !weight.is_finite() {
                return Err(format!("vertex {vertex} has a weight of {weight}"));
            }
            total += weight;
        }
        if !total.is_finite() || (total - 1.0).abs() >= 1e-3 {
            return Err(format!("the weights of vertex {vertex} sum to {total}"));
        }
    }
    Ok(())
}
