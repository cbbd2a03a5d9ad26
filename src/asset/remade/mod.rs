//! Writing a model whose triangles an edit has remade: every attribute follows its vertices.
//!
//! An edited model is described, not stored: which old vertices each of its vertices is made of ([`Recipes`]), and its
//! triangles. Texture coordinates, colours, skin weights, morph targets and whatever else the uploaded files hold are
//! read from those files when the model is written, blended by the recipes, and forgotten again.
//!
//! Owns the description, its check, and how normals and tangents follow ([`carried`]). Each format's own `remade` module
//! writes its files; what goes from one format to another goes as a [`Plain`](super::plain::Plain) model.

mod carried;
mod corners;
mod recipes;

pub(super) use carried::Carried;
pub(super) use corners::Origins;
pub use recipes::{Recipe, Recipes};

use super::model::Source;
use super::{Error, Format, Model, Primitive, Written, gltf, obj, off, plain, ply, stl};
use glam::{DAffine3, DVec3};
use std::ops::Range;

/// A model that vertices come from.
#[derive(Debug, Clone, Copy)]
pub struct Base<'a> {
    /// The model as uploaded.
    pub model: &'a Model,
    /// Where it was put: the identity for the session's own model.
    pub world_from_model: DAffine3,
}

/// A run of vertices and triangles that belong to one primitive of one base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Run {
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

impl Run {
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
pub struct Remade<'a> {
    /// The models that vertices come from: the session's own first, then those merged into it. A primitive of a base
    /// that no run names is gone.
    pub bases: &'a [Base<'a>],
    /// Who owns which vertices and triangles: runs follow each other without gaps, in vertices and in triangles.
    pub runs: &'a [Run],
    /// What each vertex is made of: render vertices of its run's primitive, numbered as in its base.
    pub recipes: &'a Recipes,
    /// Triangles over the vertices, each within its run.
    pub triangles: &'a [[u32; 3]],
    /// For each triangle the triangle of the base that it is a part of or lies on, [`NONE`](crate::mesh::NONE) where
    /// that is not known. Empty when it is known of none: the triangle that shares most of the recipes is then taken.
    pub origins: &'a [u32],
    /// For each vertex whether its surface is the edit's own (a cap, a filled hole), so that normals and tangents are
    /// taken from the triangles instead of from the recipe. Empty when there is no such vertex.
    pub bare: &'a [bool],
}

/// Writes an edited model with its vertices at `positions` (in world space, one per vertex of the recipes).
///
/// In the first base's own format (GLB and glTF count as one) the first base's file is the frame: whatever the edit did
/// not touch stays. Other bases join it: with nodes, materials and images where both are glTF, as plain geometry
/// otherwise. In another format a fresh file is made.
///
/// # Errors
/// [`Error::Unwritable`] when the description does not hold together, a position is not finite or does not fit the
/// format's numbers, no triangle is left, or the result is too large.
pub fn write_remade(remade: &Remade<'_>, positions: &[DVec3], format: Format) -> Result<Written, Error> {
    check(remade, positions, format)?;
    let Some(first) = remade.bases.first() else {
        return Err(Error::unwritable(format, "there is no base"));
    };
    let bytes = match (&first.model.source, format) {
        (Source::Gltf(_), Format::Glb | Format::Gltf) => return gltf::write_remade(remade, positions, format),
        (_, Format::Glb | Format::Gltf) => return gltf::build(&plain::of_remade(remade, positions, format)?, format),
        (Source::Obj(_), Format::Obj) => obj::write_remade(remade, positions)?,
        (Source::Ply(_), Format::Ply) => ply::write_remade(remade, positions)?,
        (Source::Off(_), Format::Off) => off::write_remade(remade, positions)?,
        (_, Format::Obj) => obj::build(&plain::of_remade(remade, positions, format)?),
        (_, Format::Ply) => ply::build(&plain::of_remade(remade, positions, format)?),
        (_, Format::Off) => off::build(&plain::of_remade(remade, positions, format)?.geometry),
        (_, Format::Stl) => stl::write_remade(remade, positions)?,
    };
    Ok(Written {
        main: bytes,
        ..Written::default()
    })
}

impl<'a> Remade<'a> {
    /// The base of a run. Checked by [`check`].
    pub(super) fn base(&self, run: &Run) -> &Base<'a> {
        &self.bases[run.base as usize]
    }

    /// The primitive of a run. Checked by [`check`].
    pub(super) fn primitive(&self, run: &Run) -> &'a Primitive {
        &self.bases[run.base as usize].model.geometry.primitives[run.primitive as usize]
    }

    /// The triangles of a run over its own vertices, counted from 0.
    pub(super) fn local_triangles(&self, run: &Run) -> Vec<[u32; 3]> {
        let triangles = self.triangles[run.triangles()].iter();
        triangles.map(|t| t.map(|v| v - run.first_vertex)).collect()
    }

    /// The recipe of a vertex. Checked by [`check`].
    pub(super) fn recipe(&self, vertex: usize) -> Recipe<'a> {
        self.recipes.get(vertex).unwrap_or(Recipe::Blend(&[]))
    }

    /// Whether normals of a vertex come from its triangles.
    pub(super) fn is_bare(&self, vertex: usize) -> bool {
        self.bare.get(vertex).copied().unwrap_or(false)
    }

    /// Whether a run has its primitive's vertices and triangles, each where it was. `old` are the primitive's triangles.
    pub(super) fn is_untouched(&self, run: &Run, old: &[[u32; 3]]) -> bool {
        let primitive = self.primitive(run);
        let shift = |t: &[u32; 3]| t.map(|v| v - run.first_vertex + primitive.first_vertex);
        primitive.vertex_count == run.vertex_count
            && old.len() == run.triangle_count as usize
            && run
                .vertices()
                .zip(primitive.first_vertex..)
                .all(|(v, old)| self.recipe(v) == Recipe::Vertex(old) && !self.is_bare(v))
            && self.triangles[run.triangles()]
                .iter()
                .map(shift)
                .eq(old.iter().copied())
    }
}

/// What the writers rely on.
fn check(remade: &Remade<'_>, positions: &[DVec3], format: Format) -> Result<(), Error> {
    let wrong = |problem: String| Err(Error::unwritable(format, problem));
    let count = remade.recipes.len();
    if positions.len() != count {
        let seen = positions.len();
        return wrong(format!("{seen} positions are given, the model has {count} vertices"));
    }
    if let Some(i) = positions.iter().position(|p| !p.is_finite()) {
        return wrong(format!("the position of vertex {i} is {}, not finite", positions[i]));
    }
    if u32::try_from(count).is_err() || u32::try_from(remade.triangles.len()).is_err() {
        return wrong(format!("{count} vertices and {} triangles", remade.triangles.len()));
    }
    if remade.triangles.is_empty() {
        return wrong("no triangle is left".into());
    }
    for (what, length, wanted) in [
        ("origins", remade.origins.len(), remade.triangles.len()),
        ("marks of bare vertices", remade.bare.len(), count),
    ] {
        if length != 0 && length != wanted {
            return wrong(format!("{length} {what} are given, {wanted} are needed, or none"));
        }
    }
    if let Some(i) = remade.bases.iter().position(|b| !b.world_from_model.is_finite()) {
        return wrong(format!("the transform of base {i} is not finite"));
    }
    let (mut vertex, mut triangle) = (0, 0);
    for (i, run) in remade.runs.iter().enumerate() {
        if run.first_vertex as usize != vertex || run.first_triangle as usize != triangle {
            return wrong(format!("run {i} does not begin where the one before it ends"));
        }
        (vertex, triangle) = (run.vertices().end, run.triangles().end);
        if vertex > count || triangle > remade.triangles.len() {
            return wrong(format!("run {i} reaches past the last vertex or triangle"));
        }
        let base = remade.bases.get(run.base as usize);
        let Some(primitive) = base.and_then(|b| b.model.geometry.primitives.get(run.primitive as usize)) else {
            return wrong(format!(
                "run {i}: primitive {} of base {} does not exist",
                run.primitive, run.base
            ));
        };
        check_run(remade, run, primitive).or_else(|problem| wrong(format!("run {i}: {problem}")))?;
    }
    if (vertex, triangle) != (count, remade.triangles.len()) {
        return wrong(format!("the runs end at vertex {vertex} and triangle {triangle}"));
    }
    Ok(())
}

fn check_run(remade: &Remade<'_>, run: &Run, primitive: &Primitive) -> Result<(), String> {
    let own = run.vertices();
    for (i, triangle) in remade.triangles[run.triangles()].iter().enumerate() {
        if triangle.iter().any(|&v| !own.contains(&(v as usize))) {
            return Err(format!(
                "triangle {i} has the corners {triangle:?}, its vertices are {own:?}"
            ));
        }
    }
    let old = u64::from(primitive.first_vertex)..u64::from(primitive.first_vertex) + u64::from(primitive.vertex_count);
    for vertex in own {
        let mut total = 0.0;
        for (of, weight) in remade.recipe(vertex).iter() {
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
