//! What everything in a deformer is derived from: the model as it was read, or as edits have left it.

use super::edit_surface::{EditSurface, triangle_primitives};
use super::error::Error;
use super::part_families::{PartFamilies, VertexOrigins};
use super::riding::RidingNodes;
use crate::asset::{self, Format, Geometry, Model, Primitive, ShapeFollowers, WrittenFiles};
use crate::edit::{NewVertex, PatchedSurface, SurfacePatch};
use crate::mesh::{Mesh, NONE, Weld};
use glam::{DVec3, Vec3, Vec4};
use sha2::{Digest, Sha256};
use std::mem::take;
use std::sync::Arc;

/// A model and what edits have made of it. Never changes; an edit makes another one.
#[derive(Debug)]
pub(super) struct ModelTopology {
    /// The model as it was read.
    pub model: Arc<Model>,
    /// Digest of its file.
    pub sha256: Arc<str>,
    /// Rest positions, one per render vertex.
    pub rest: Arc<Vec<DVec3>>,
    /// Nodes of its file that ride along, where they are in the rest pose.
    pub riding_nodes: Arc<RidingNodes>,
    /// What edits have made of it.
    pub edited: Option<EditedTopology>,
}

/// An edited model.
#[derive(Debug)]
pub(super) struct EditedTopology {
    /// Render vertices, triangles and primitives; positions are empty, [`ModelTopology::rest`] has them.
    pub geometry: Geometry,
    /// What the vertices are made of.
    pub origins: VertexOrigins,
    /// The solver vertex of each render vertex.
    pub point_of: Vec<u32>,
    /// How many there are.
    pub points: u32,
    /// Whether a cut has made parts that touch and do not belong together.
    pub apart: bool,
    /// Which parts were one.
    pub families: PartFamilies,
    /// Whether an edit has made a posed shape the rest pose, so that it is not that of the file.
    pub posed: bool,
}

impl ModelTopology {
    /// Of a model that was just read.
    pub fn new(model: Model) -> Self {
        let sha256 = Sha256::digest(&model.files.main);
        let sha256: String = sha256.iter().map(|b| format!("{b:02x}")).collect();
        Self {
            sha256: sha256.into(),
            ..Self::from_shared_model(Arc::new(model))
        }
    }

    /// Of a shared model, without its digest.
    pub fn from_shared_model(model: Arc<Model>) -> Self {
        Self {
            rest: Arc::new(model.positions.clone()),
            model,
            sha256: "".into(),
            riding_nodes: Arc::default(),
            edited: None,
        }
    }

    /// Triangles, normals, tangents and primitives.
    pub fn geometry(&self) -> &Geometry {
        self.edited.as_ref().map_or(&self.model.geometry, |e| &e.geometry)
    }

    /// The mesh that the solver sees.
    pub fn mesh(&self, weld: Weld) -> Result<Mesh, Error> {
        let build = |triangles: &[[u32; 3]]| match &self.edited {
            None => Mesh::build(&self.rest, triangles, weld),
            Some(e) => Mesh::of_points(&self.rest, triangles, e.point_of.clone(), e.points as usize),
        };
        let mesh = if self.has_passengers() {
            self.mesh_without_passengers(build)
        } else {
            build(&self.geometry().triangles)
        };
        let format = self.model.format;
        mesh.map_err(|e| {
            let problem = match e {
                crate::mesh::Error::Invalid { field, problem } => format!("{field} {problem}"),
                other => other.to_string(),
            };
            asset::Error::NoMesh { format, problem }.into()
        })
    }

    /// Whether primitives ride along that are no part of the mesh.
    pub fn has_passengers(&self) -> bool {
        self.geometry().primitives.iter().any(|p| p.is_passenger)
    }

    /// Number of render vertices that ride along.
    pub fn passenger_vertices(&self) -> usize {
        let passengers = self.geometry().primitives.iter().filter(|p| p.is_passenger);
        passengers.map(|p| p.vertices().len()).sum()
    }

    /// The mesh of all triangles but those of passengers, in the numbers of all.
    fn mesh_without_passengers(
        &self,
        build: impl Fn(&[[u32; 3]]) -> Result<Mesh, crate::mesh::Error>,
    ) -> Result<Mesh, crate::mesh::Error> {
        let geometry = self.geometry();
        let of_triangle = triangle_primitives(&geometry.primitives, geometry.triangles.len());
        let solved = |t: &u32| !geometry.primitives[of_triangle[*t as usize] as usize].is_passenger;
        let kept: Vec<u32> = (0..geometry.triangles.len() as u32).filter(solved).collect();
        let triangles: Vec<[u32; 3]> = kept.iter().map(|&t| geometry.triangles[t as usize]).collect();
        let mut mesh = build(&triangles)?;
        let Mesh {
            source_triangle,
            collapsed_triangles,
            duplicate_triangles,
            ..
        } = &mut mesh;
        for numbers in [source_triangle, collapsed_triangles, duplicate_triangles] {
            numbers.iter_mut().for_each(|t| *t = kept[*t as usize]);
        }
        Ok(mesh)
    }

    /// Number of triangles that ride along.
    pub fn passenger_triangles(&self) -> usize {
        let passengers = self.geometry().primitives.iter().filter(|p| p.is_passenger);
        passengers.map(|p| p.index_count as usize / 3).sum()
    }

    /// What the vertices and the triangles of the mesh are made of; `mesh` is this model's.
    pub fn origins(&self, mesh: &Mesh) -> VertexOrigins {
        match &self.edited {
            Some(e) if self.has_passengers() => e.origins.with_triangles(&mesh.source_triangle),
            Some(e) => e.origins.clone(),
            None => VertexOrigins::of_model(&self.model, &mesh.source_triangle),
        }
    }

    /// The model at `positions` as files.
    pub fn write(
        &self,
        positions: &[DVec3],
        format: Format,
        followers: &ShapeFollowers<'_>,
    ) -> Result<WrittenFiles, Error> {
        Ok(match &self.edited {
            None => self.model.write_following(positions, format, followers.clone())?,
            Some(edited) => edited.origins.write(&edited.geometry, positions, format, followers)?,
        })
    }

    /// Bytes held, without those of the files.
    pub fn byte_size(&self) -> u64 {
        let edited = self.edited.as_ref().map_or(0, |e| {
            e.geometry.bytes_held() + e.origins.byte_size() + e.families.byte_size() + 4 * e.point_of.capacity() as u64
        });
        self.model.bytes_beside_files() + edited + (self.rest.capacity() * 24 + self.riding_nodes.byte_size()) as u64
    }

    /// The topology after an edit of `before`, whose vertices are made of `origins`, and the maps that are left of
    /// `applied`. `families` are those of the surface after it.
    pub fn after_edit(
        &self,
        before: &EditSurface,
        origins: &VertexOrigins,
        mut applied: PatchedSurface,
        patch: &SurfacePatch,
        families: PartFamilies,
    ) -> (Self, PatchedSurface) {
        let normals = edited_normals(before, &applied, patch);
        let own = |v: usize| is_own(before, &applied, patch, &normals, v);
        let mut origins = origins.after_edit(&applied, patch, own);
        let mut geometry = Geometry {
            positions: Vec::new(),
            normals,
            tangents: edited_tangents(before, &applied, patch),
            primitives: edited_primitives(before, &applied),
            warnings: self.model.warnings.clone(),
            triangles: take(&mut applied.triangles),
        };
        if self.has_passengers() {
            self.restore_passengers(&mut geometry, &mut origins, &applied.vertex_from_old);
        }
        let topology = Self {
            model: Arc::clone(&self.model),
            sha256: Arc::clone(&self.sha256),
            rest: Arc::new(take(&mut applied.positions)),
            riding_nodes: Arc::clone(&self.riding_nodes),
            edited: Some(EditedTopology {
                geometry,
                origins,
                point_of: take(&mut applied.point_of),
                points: applied.points,
                apart: self.is_apart(),
                families,
                posed: self.edited.as_ref().is_some_and(|e| e.posed),
            }),
        };
        (topology, applied)
    }

    /// Puts the triangles of passengers, which no edit touches, back among those of an edited mesh: `geometry` and `origins`
    /// have all primitives and the triangles of the others.
    fn restore_passengers(&self, geometry: &mut Geometry, origins: &mut VertexOrigins, vertex_from_old: &[u32]) {
        let old = self.geometry();
        let mut own = old.triangles_of_primitives();
        let (mut triangles, mut was) = (Vec::new(), Vec::new());
        let (mut solved, mut first_old) = (0, 0);
        for primitive in &mut geometry.primitives {
            let (before, theirs) = own.next().unzip();
            let theirs = theirs.unwrap_or_default();
            if before.is_some_and(|p| p.is_passenger) {
                primitive.index_count = 3 * theirs.len() as u32;
                triangles.extend(theirs.iter().map(|t| t.map(|v| vertex_from_old[v as usize])));
                was.extend((first_old..first_old + theirs.len()).map(|t| self.base_triangle(t)));
            } else {
                let end = solved + primitive.index_count as usize / 3;
                triangles.extend_from_slice(&geometry.triangles[solved..end]);
                was.extend((solved..end).map(|t| origins.base_triangle(t)));
                solved = end;
            }
            first_old += theirs.len();
        }
        geometry.triangles = triangles;
        origins.set_triangles(was);
    }

    /// The triangle of its base that a triangle was.
    fn base_triangle(&self, triangle: usize) -> u32 {
        match &self.edited {
            Some(e) => e.origins.base_triangle(triangle),
            None => triangle as u32,
        }
    }

    /// Says that its rest pose is a posed shape, with the nodes that ride along as they are there.
    pub fn take_posed_rest(&mut self, riding_nodes: Arc<RidingNodes>) {
        self.riding_nodes = riding_nodes;
        if let Some(edited) = &mut self.edited {
            edited.posed = true;
        }
    }

    /// Whether a cut has made parts that touch and do not belong together.
    pub fn is_apart(&self) -> bool {
        self.edited.as_ref().is_some_and(|e| e.apart)
    }
}

fn edited_primitives(before: &EditSurface, applied: &PatchedSurface) -> Vec<Primitive> {
    let vertices = applied.positions.len() as u32;
    let mut triangles = vec![0u32; before.primitives.len()];
    applied.primitive_of.iter().for_each(|&p| triangles[p as usize] += 1);
    let firsts = &applied.first_vertex;
    let end = |p: usize| firsts.get(p + 1).copied().unwrap_or(vertices);
    (before.primitives.iter().enumerate())
        .map(|(p, primitive)| Primitive {
            first_vertex: firsts[p],
            vertex_count: end(p) - firsts[p],
            index_count: 3 * triangles[p],
            ..primitive.clone()
        })
        .collect()
}

/// Normals after an edit: old vertices keep theirs, new ones have the mean of their triangles', or of what they are blended from
/// where no triangle has them.
fn edited_normals(before: &EditSurface, applied: &PatchedSurface, patch: &SurfacePatch) -> Vec<Vec3> {
    if before.normals.is_empty() {
        return Vec::new();
    }
    let old = before.positions.len();
    let mut sums = vec![DVec3::ZERO; applied.positions.len()];
    for t in &applied.triangles {
        if t.iter().all(|&v| (applied.old_from_vertex[v as usize] as usize) < old) {
            continue;
        }
        let [a, b, c] = t.map(|v| applied.positions[v as usize]);
        let normal = (b - a).cross(c - a);
        t.iter().for_each(|&v| sums[v as usize] += normal);
    }
    let mut normals: Vec<Vec3> = (applied.old_from_vertex.iter().zip(sums))
        .map(|(&was, sum)| match before.normals.get(was as usize) {
            Some(&normal) => normal,
            None => sum.try_normalize().unwrap_or(DVec3::Z).as_vec3(),
        })
        .collect();
    let of_lines = (applied.old_from_vertex.iter().zip(&applied.point_of).enumerate())
        .filter(|(_, (was, point))| **point == NONE && **was as usize >= old);
    for (v, (&was, _)) in of_lines {
        let parts = patch.vertices[was as usize - old].parts();
        let sum: Vec3 = parts.map(|(v, w)| before.normals[v as usize] * w as f32).sum();
        normals[v] = sum.try_normalize().unwrap_or(Vec3::ZERO);
    }
    for (p, _) in before.primitives.iter().enumerate().filter(|(_, p)| !p.has_normals) {
        let end = applied.first_vertex.get(p + 1).map_or(normals.len(), |&v| v as usize);
        normals[applied.first_vertex[p] as usize..end].fill(Vec3::ZERO);
    }
    normals
}

/// Whether a new vertex lies on surface that the edit has made: its triangles face elsewhere than what it is blended from.
fn is_own(
    before: &EditSurface,
    applied: &PatchedSurface,
    patch: &SurfacePatch,
    normals: &[Vec3],
    vertex: usize,
) -> bool {
    const ALIKE: f32 = 0.5;
    if applied.point_of[vertex] == NONE {
        return false;
    }
    let old = before.positions.len();
    let new = (applied.old_from_vertex[vertex] as usize).checked_sub(old);
    if new.is_some_and(|k| patch.flat.binary_search(&(k as u32)).is_ok()) {
        return true;
    }
    let is_cap = |v: &NewVertex| patch.caps.iter().any(|cap| cap.0 == v.primitive);
    if new.and_then(|k| patch.vertices.get(k)).is_some_and(is_cap) {
        return true;
    }
    let (Some(new), false) = (new.and_then(|k| patch.vertices.get(k)), before.normals.is_empty()) else {
        return false;
    };
    let sum: Vec3 = (new.parts()).map(|(v, w)| before.normals[v as usize] * w as f32).sum();
    sum.normalize_or_zero().dot(normals[vertex]) < ALIKE
}

/// Tangents after an edit: those of new vertices are blended.
fn edited_tangents(before: &EditSurface, applied: &PatchedSurface, patch: &SurfacePatch) -> Vec<Vec4> {
    if before.tangents.is_empty() {
        return Vec::new();
    }
    let old = before.positions.len();
    let blended = |k: usize| {
        let new = patch.vertices.get(k)?;
        let mut sum = Vec4::ZERO;
        let mut hand = 0.0;
        for (v, w) in new.parts() {
            let tangent = before.tangents[v as usize];
            hand = if hand == 0.0 { tangent.w } else { hand };
            sum += tangent * w as f32;
        }
        Some(sum.truncate().try_normalize()?.extend(hand))
    };
    (applied.old_from_vertex.iter())
        .map(|&was| match before.tangents.get(was as usize) {
            Some(&tangent) => tangent,
            None => blended(was as usize - old).unwrap_or(Vec4::ZERO),
        })
        .collect()
}
