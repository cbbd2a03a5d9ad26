//! Which render vertices of one point are one vertex to an edit.
//!
//! A file may repeat a vertex for each triangle around it: every STL does, and so does whatever was written without indices.
//! An operation sees a seam where two triangles show different vertices along their edge, so such copies are made one for it:
//! the first stands for all that are of its primitive and have its attributes. What really differs stays apart.
//!
//! Facet normals differ from triangle to triangle, and say nothing that the triangles do not say. Vertices that have no other
//! ones are apart where the surface has an edge, and alike where it is nearly flat; new triangles there are shaded flat
//! again, with vertices of their own.

use super::error::Error;
use super::part_families::VertexOrigins;
use crate::asset::{Geometry, VertexAttributes, VertexBlend, agrees_with_facet, facet_normal, normal_key};
use crate::edit::{BlendedVertex, NewVertex, SurfacePatch, SurfaceView};
use crate::mesh::{Mesh, NONE, mix_bits};
use crate::progress::{Progress, check};
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;

/// Facets that meet at more than 40° have an edge between them, as remeshing sees it: the cosine.
const SHARP: f64 = 0.766_044_443_118_978;

/// Which render vertices of a surface stand for which.
#[derive(Debug, Clone, Default)]
pub(super) struct Seams {
    /// For each render vertex the one that stands for it; empty when each stands for itself.
    stands_for: Vec<u32>,
    /// Of those that stand for others, whether these have facet normals that differ; empty when none has.
    facets: Vec<bool>,
}

impl Seams {
    /// Finds the seams of a model. `rest` are its positions, `mesh` is its mesh; `origins` gives vertex origins.
    pub fn find(
        geometry: &Geometry,
        rest: &[DVec3],
        mesh: &Mesh,
        origins: &VertexOrigins,
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let primitive_of = primitives_of_vertices(geometry, rest.len());
        let repeats = |vertices: &[u32]| {
            let mut pairs = vertices.windows(2);
            pairs.any(|pair| primitive_of[pair[0] as usize] == primitive_of[pair[1] as usize])
        };
        let rows = (0..mesh.positions.len() as u32).map(|p| mesh.render_vertices_of(p));
        if !rows.clone().any(repeats) {
            return Ok(Self::default());
        }
        let comparison = Comparison::new(geometry, rest, mesh, origins, &primitive_of, progress)?;
        check(progress)?;
        let mut sets = VertexSets::new(rest.len());
        let mut keys: Vec<(u32, u64, u32)> = Vec::new();
        for vertices in rows.filter(|vertices| repeats(vertices)) {
            keys.clear();
            keys.extend(
                vertices
                    .iter()
                    .map(|&v| (primitive_of[v as usize], comparison.full_key(v), v)),
            );
            keys.sort_unstable();
            for alike in keys.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
                alike
                    .iter()
                    .for_each(|other| sets.parent[other.2 as usize] = alike[0].2);
            }
        }
        check(progress)?;
        let facets = comparison.join_facets(&mut sets);
        Ok(sets.into_seams(&facets))
    }

    /// Whether each vertex stands for itself.
    pub fn is_empty(&self) -> bool {
        self.stands_for.is_empty()
    }

    /// The vertex that stands for a vertex.
    pub fn first_of(&self, vertex: u32) -> u32 {
        self.stands_for.get(vertex as usize).copied().unwrap_or(vertex)
    }

    fn is_facet(&self, vertex: u32) -> bool {
        self.facets.get(vertex as usize).copied().unwrap_or(false)
    }

    /// The vertex that a vertex may be replaced by, with all that it has.
    pub fn same_as(&self, vertex: u32) -> u32 {
        let first = self.first_of(vertex);
        if self.is_facet(first) { vertex } else { first }
    }

    /// Appends the seams of a surface of which `vertices` vertices come after the `before` ones here.
    pub fn append(&mut self, other: &Self, before: usize, vertices: usize) {
        if self.is_empty() && other.is_empty() {
            return;
        }
        let known = self.stands_for.len() as u32;
        self.stands_for.extend(known..before as u32);
        let added = (0..vertices as u32).map(|v| before as u32 + other.first_of(v));
        self.stands_for.extend(added);
        append_padded(&mut self.facets, &other.facets, [before, vertices], false);
    }

    /// Marks all vertices that one stands for, where one of them is marked.
    pub fn spread<T: PartialOrd + Copy>(&self, marks: &mut [T]) {
        for most in [true, false] {
            for (v, &first) in self.stands_for.iter().enumerate().take(marks.len()) {
                let (from, to) = if most { (v, first as usize) } else { (first as usize, v) };
                if marks[from] > marks[to] {
                    marks[to] = marks[from];
                }
            }
        }
    }

    /// Gives the attributes that a vertex takes to all that it stands for. Where the surface is shaded flat all corners of
    /// `triangles`, those of the surface, that have turned show it.
    pub fn spread_blends(&self, patch: &mut SurfacePatch, triangles: &[[u32; 3]]) {
        if self.is_empty() || patch.blended.is_empty() {
            return;
        }
        let taken = std::mem::take(&mut patch.blended);
        let place = |first: u32| taken.binary_search_by_key(&first, |b| b.vertex);
        let mut turned = vec![false; self.stands_for.len()];
        for t in triangles
            .iter()
            .filter(|t| t.iter().any(|&v| place(self.first_of(v)).is_ok()))
        {
            t.iter().for_each(|&v| turned[v as usize] = true);
        }
        for (vertex, &first) in (0u32..).zip(&self.stands_for) {
            let own = BlendedVertex {
                vertex,
                of: [vertex; 3],
                weights: [1.0, 0.0, 0.0],
                flat: self.is_facet(first),
            };
            match place(first) {
                Ok(k) => patch.blended.push(BlendedVertex {
                    of: taken[k].of,
                    weights: taken[k].weights,
                    ..own
                }),
                Err(_) if turned[vertex as usize] && own.flat => patch.blended.push(own),
                Err(_) => {}
            }
        }
    }

    /// Gives each new triangle vertices of its own where the surface is shaded flat. `before` is the surface that the patch
    /// is for.
    pub fn part_facets(&self, patch: &mut SurfacePatch, before: &SurfaceView<'_>) {
        if self.facets.is_empty() {
            return;
        }
        let count = before.positions.len();
        let moved: BTreeMap<u32, DVec3> = patch.moved.iter().copied().collect();
        let facet = |v: &NewVertex| v.parts().any(|(v, _)| self.is_facet(v));
        // The corners of each new vertex that is to be many.
        let mut corners_of: Vec<Vec<(usize, usize)>> = vec![Vec::new(); patch.vertices.len()];
        let is_parted: Vec<bool> = patch.vertices.iter().map(facet).collect();
        let mut at_old = Vec::new();
        for (t, triangle) in patch.triangles.iter().enumerate() {
            for (k, &corner) in triangle.corners.iter().enumerate() {
                match (corner as usize).checked_sub(count) {
                    Some(new) => corners_of[new].push((t, k)),
                    None if self.is_facet(corner) => at_old.push((t, k)),
                    None => {}
                }
            }
        }
        let mut vertices = Vec::new();
        for ((vertex, corners), parted) in std::mem::take(&mut patch.vertices)
            .into_iter()
            .zip(corners_of)
            .zip(is_parted)
        {
            let first = (count + vertices.len()) as u32;
            for (i, (t, k)) in corners.into_iter().enumerate() {
                patch.triangles[t].corners[k] = first + if parted { i as u32 } else { 0 };
                if parted {
                    patch.flat.push(vertices.len() as u32);
                }
                if parted || i == 0 {
                    vertices.push(vertex.clone());
                }
            }
        }
        for (t, k) in at_old {
            let triangle = &mut patch.triangles[t];
            let corner = triangle.corners[k];
            let point = before.point_of[corner as usize];
            patch.flat.push(vertices.len() as u32);
            triangle.corners[k] = (count + vertices.len()) as u32;
            vertices.push(NewVertex {
                primitive: triangle.primitive,
                point,
                position: moved.get(&point).copied().unwrap_or(before.positions[corner as usize]),
                of: [corner; 3],
                weights: [1.0, 0.0, 0.0],
            });
        }
        patch.vertices = vertices;
    }
}

/// Appends what the vertices of another surface have, where either has any: `counts` are the vertices of both, and `none` stands
/// for those without.
pub(super) fn append_padded<T: Copy>(own: &mut Vec<T>, other: &[T], counts: [usize; 2], none: T) {
    if own.is_empty() && other.is_empty() {
        return;
    }
    own.resize(counts[0], none);
    own.extend_from_slice(other);
    own.resize(counts[0] + counts[1], none);
}

/// Sets of vertices, each named by the smallest one.
struct VertexSets {
    parent: Vec<u32>,
}

impl VertexSets {
    fn new(vertices: usize) -> Self {
        Self {
            parent: (0..vertices as u32).collect(),
        }
    }

    fn first_of(&mut self, mut v: u32) -> u32 {
        while self.parent[v as usize] != v {
            let above = self.parent[self.parent[v as usize] as usize];
            self.parent[v as usize] = above;
            v = above;
        }
        v
    }

    /// Joins two sets; whether they were two.
    fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.first_of(a), self.first_of(b));
        self.parent[a.max(b) as usize] = a.min(b);
        a != b
    }

    /// `facets` are vertices of sets that have facet normals.
    fn into_seams(mut self, facets: &[u32]) -> Seams {
        let stands_for: Vec<u32> = (0..self.parent.len() as u32).map(|v| self.first_of(v)).collect();
        if stands_for.iter().zip(0u32..).all(|(first, v)| *first == v) {
            return Seams::default();
        }
        let mut seams = Seams {
            facets: if facets.is_empty() {
                Vec::new()
            } else {
                vec![false; stands_for.len()]
            },
            stands_for,
        };
        for &v in facets {
            seams.facets[seams.stands_for[v as usize] as usize] = true;
        }
        seams
    }
}

/// What vertices are compared by.
struct Comparison<'a> {
    mesh: &'a Mesh,
    geometry: &'a Geometry,
    rest: &'a [DVec3],
    origins: &'a VertexOrigins,
    /// The attributes of each model that vertices come from.
    bases: Vec<&'a VertexAttributes>,
    normals: Vec<&'a [Vec3]>,
    /// The primitive of each vertex.
    primitive_of: &'a [u32],
    /// Of vertices on surface that edits have made, whether their normals are those of their triangles.
    bare_facets: Vec<bool>,
}

impl<'a> Comparison<'a> {
    fn new(
        geometry: &'a Geometry,
        rest: &'a [DVec3],
        mesh: &'a Mesh,
        origins: &'a VertexOrigins,
        primitive_of: &'a [u32],
        progress: &dyn Progress,
    ) -> Result<Self, Error> {
        let models = || origins.models();
        let mut comparison = Self {
            mesh,
            geometry,
            rest,
            origins,
            bases: models()
                .map(|m| m.vertex_attributes(progress))
                .collect::<Result<_, _>>()?,
            normals: models().map(|m| &m.normals[..]).collect(),
            primitive_of,
            bare_facets: Vec::new(),
        };
        if !geometry.normals.is_empty() && origins.has_bare() {
            comparison.bare_facets = vec![true; rest.len()];
            for t in mesh.source_triangle.iter().map(|&t| geometry.triangles[t as usize]) {
                if t.iter().any(|&v| origins.is_bare(v)) {
                    let normal = comparison.facet_normal(t);
                    for v in t {
                        comparison.bare_facets[v as usize] &= agrees_with_facet(normal, geometry.normals[v as usize]);
                    }
                }
            }
        }
        Ok(comparison)
    }

    fn base_of(&self, vertex: u32) -> usize {
        self.origins.base_of_primitive(self.primitive_of[vertex as usize])
    }

    fn has_normals(&self, vertex: u32) -> bool {
        let primitive = self.primitive_of[vertex as usize];
        self.geometry.primitives[primitive as usize].has_normals
    }

    fn facet_normal(&self, t: [u32; 3]) -> Option<DVec3> {
        facet_normal(t.map(|v| self.rest[v as usize]))
    }

    /// A key of what a vertex is made of; `part` gives the key of each part.
    fn blended_key(&self, vertex: u32, part: impl Fn(u32) -> u64) -> u64 {
        let entries = match self.origins.blend(vertex) {
            Some(VertexBlend::Blend(entries)) => entries,
            Some(VertexBlend::Vertex(old)) => return part(old),
            None => return 0,
        };
        let mut parts: Vec<(u64, f32)> = entries.iter().map(|&(old, weight)| (part(old), weight)).collect();
        parts.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        parts.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            kept.1 += if same { next.1 } else { 0.0 };
            same
        });
        match parts.as_slice() {
            [(key, _)] => *key,
            many => many.iter().fold(1, |hash, &(key, weight)| {
                mix_bits(mix_bits(hash, key), u64::from(weight.to_bits()))
            }),
        }
    }

    /// Stands for all attributes of a vertex but its normal.
    fn key(&self, vertex: u32) -> u64 {
        let base = self.bases[self.base_of(vertex)];
        self.blended_key(vertex, |old| base.key(old))
    }

    /// The same with the normal. On surface that an edit has made it is that of the triangles.
    fn full_key(&self, vertex: u32) -> u64 {
        let own = self.geometry.normals.get(vertex as usize);
        let Some(own) = own.filter(|_| self.has_normals(vertex)) else {
            return self.key(vertex);
        };
        if self.origins.is_bare(vertex) {
            return mix_bits(mix_bits(self.key(vertex), normal_key(*own)), 1);
        }
        let base = self.base_of(vertex);
        let (attributes, normals) = (self.bases[base], self.normals[base]);
        let normal = |old: u32| normals.get(old as usize).map_or(0, |n| normal_key(*n));
        self.blended_key(vertex, |old| mix_bits(attributes.key(old), normal(old)))
    }

    fn has_facet_normal(&self, vertex: u32) -> bool {
        if !self.has_normals(vertex) {
            return false;
        }
        if self.origins.is_bare(vertex) {
            return self.bare_facets.get(vertex as usize).copied().unwrap_or(false);
        }
        let base = self.bases[self.base_of(vertex)];
        let blend = self.origins.blend(vertex);
        blend.is_some_and(|blend| blend.iter().all(|(old, _)| base.has_facet_normal(old)))
    }

    /// Joins vertices with facet normals across the edges that are not sharp; those of sets that were joined by it.
    fn join_facets(&self, sets: &mut VertexSets) -> Vec<u32> {
        let geometry = self.geometry;
        if !geometry.primitives.iter().any(|p| p.has_normals) {
            return Vec::new();
        }
        // Each side of a triangle with such vertices: its edge and the triangle.
        let mut sides: Vec<([u32; 2], u32)> = Vec::new();
        for (f, (points, &t)) in self.mesh.triangles.iter().zip(&self.mesh.source_triangle).enumerate() {
            let corners = geometry.triangles[t as usize];
            let is_parted =
                |(&p, v): (&u32, u32)| self.mesh.render_vertices_of(p).len() > 1 && self.has_facet_normal(v);
            if points.iter().zip(corners).any(is_parted) {
                sides.extend([0, 1, 2].map(|k| {
                    let (a, b) = (points[k], points[(k + 1) % 3]);
                    ([a.min(b), a.max(b)], f as u32)
                }));
            }
        }
        sides.sort_unstable();
        let mut joined = Vec::new();
        for pair in sides.chunk_by(|a, b| a.0 == b.0).filter(|along| along.len() == 2) {
            let [f, g] = [pair[0].1, pair[1].1];
            let [one, two] = [f, g].map(|f| geometry.triangles[self.mesh.source_triangle[f as usize] as usize]);
            let flat = match (self.facet_normal(one), self.facet_normal(two)) {
                (Some(n), Some(m)) => n.dot(m) >= SHARP,
                _ => true,
            };
            if !flat || self.primitive_of[one[0] as usize] != self.primitive_of[two[0] as usize] {
                continue;
            }
            for p in pair[0].0 {
                let at = |f: u32, corners: [u32; 3]| {
                    let points = self.mesh.triangles[f as usize];
                    points.iter().position(|&q| q == p).map_or(NONE, |k| corners[k])
                };
                let (v, w) = (at(f, one), at(g, two));
                let alike = v != w
                    && [v, w].iter().all(|&v| v != NONE && self.has_facet_normal(v))
                    && self.key(v) == self.key(w);
                if alike && sets.join(v, w) {
                    joined.push(v);
                }
            }
        }
        joined
    }
}

/// The primitive of each render vertex.
fn primitives_of_vertices(geometry: &Geometry, vertices: usize) -> Vec<u32> {
    let mut of = Vec::with_capacity(vertices);
    for (p, primitive) in (0u32..).zip(&geometry.primitives) {
        of.resize(primitive.vertices().end, p);
    }
    of.resize(vertices, 0);
    of
}
