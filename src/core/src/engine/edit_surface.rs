//! The surface that an edit works on.

use super::seams::{Seams, append_padded};
use super::shape::{Authored, Shading};
use crate::asset::{Geometry, Primitive};
use crate::edit::{SurfacePatch, SurfaceView};
use crate::mesh::{Mesh, NONE};
use glam::{DVec3, Vec3, Vec4};

/// The surface, with its attributes.
#[derive(Debug, Clone, Default)]
pub(super) struct EditSurface {
    /// Render vertices in the shape that is edited.
    pub positions: Vec<DVec3>,
    /// Triangles that the solver sees, over render vertices.
    pub triangles: Vec<[u32; 3]>,
    /// The primitive of each triangle.
    pub primitive_of: Vec<u32>,
    /// The solver vertex of each render vertex.
    pub point_of: Vec<u32>,
    /// How many there are.
    pub points: u32,
    /// Normals in that shape, or none.
    pub normals: Vec<Vec3>,
    /// Tangents in that shape, or none.
    pub tangents: Vec<Vec4>,
    /// The runs of render vertices.
    pub primitives: Vec<Primitive>,
    /// Which render vertices are one to an operation.
    pub seams: Seams,
    /// The triangles over those; empty where they are the same.
    seamless: Vec<[u32; 3]>,
    /// Vertices that only triangles use which the solver does not see, rising: the first edit leaves both out.
    pub idle_vertices: Vec<u32>,
}

impl EditSurface {
    /// The surface of a mesh in the shape `positions`.
    pub fn new(
        mesh: &Mesh,
        geometry: &Geometry,
        positions: &[DVec3],
        Shading { normals, tangents }: Shading,
        seams: Seams,
    ) -> Self {
        let of_triangle = triangle_primitives(&geometry.primitives, geometry.triangles.len());
        let mut surface = Self {
            // Welding by tolerance leaves vertices of one point a little apart; an edit makes them one.
            positions: (0..positions.len())
                .map(|v| match mesh.solver_from_render[v] {
                    NONE => positions[v],
                    s => positions[mesh.render_vertices_of(s)[0] as usize],
                })
                .collect(),
            triangles: mesh
                .source_triangle
                .iter()
                .map(|&t| geometry.triangles[t as usize])
                .collect(),
            primitive_of: mesh.source_triangle.iter().map(|&t| of_triangle[t as usize]).collect(),
            point_of: mesh.solver_from_render.clone(),
            points: mesh.positions.len() as u32,
            normals,
            tangents,
            primitives: geometry.primitives.clone(),
            seams,
            seamless: Vec::new(),
            idle_vertices: idle_vertices(mesh, geometry),
        };
        surface.leave_out_seams();
        surface
    }

    fn leave_out_seams(&mut self) {
        if !self.seams.is_empty() {
            let triangles = self.triangles.iter();
            self.seamless = triangles.map(|t| t.map(|v| self.seams.first_of(v))).collect();
        }
    }

    /// What an operation reads: one vertex stands for all that differ in nothing.
    pub fn surface(&self) -> SurfaceView<'_> {
        SurfaceView {
            triangles: if self.seams.is_empty() {
                &self.triangles
            } else {
                &self.seamless
            },
            ..self.own_surface()
        }
    }

    /// The surface with the vertices that its triangles really have: what a patch is applied to, so that triangles that stay
    /// keep theirs.
    pub fn own_surface(&self) -> SurfaceView<'_> {
        SurfaceView {
            positions: &self.positions,
            triangles: &self.triangles,
            primitive_of: &self.primitive_of,
            point_of: &self.point_of,
            points: self.points,
        }
    }

    /// Makes vertices that differ in nothing one; says how many go by it.
    pub fn join_equal_vertices(&mut self) -> usize {
        let mut gone = Vec::new();
        for v in self.triangles.as_flattened_mut() {
            let same = self.seams.same_as(*v);
            if same != *v {
                gone.push(std::mem::replace(v, same));
            }
        }
        gone.sort_unstable();
        gone.dedup();
        self.idle_vertices.extend(&gone);
        gone.len()
    }

    /// Turns normals and tangents with the triangles when points move; the positions stay.
    pub fn follow_moves(&mut self, patch: &SurfacePatch) {
        if self.normals.is_empty() || patch.moved.is_empty() {
            return;
        }
        let mut places = vec![None; self.points as usize];
        for &(point, place) in &patch.moved {
            places[point as usize] = Some(place);
        }
        let moved: Vec<DVec3> = (self.positions.iter().zip(&self.point_of))
            .map(|(&x, &p)| places.get(p as usize).copied().flatten().unwrap_or(x))
            .collect();
        let Self {
            triangles,
            normals,
            tangents,
            primitives,
            positions,
            ..
        } = self;
        let authored = Authored {
            triangles,
            normals,
            tangents,
            primitives,
            rest: positions,
            beside: &[],
        };
        let followed = authored.shade(&moved);
        let (was, now) = (&*positions, &moved);
        let touched = triangles
            .iter()
            .filter(|t| t.iter().any(|&v| was[v as usize] != now[v as usize]));
        let mut turned = vec![false; now.len()];
        touched.flatten().for_each(|&v| turned[v as usize] = true);
        for v in (0..turned.len()).filter(|&v| turned[v]) {
            normals[v] = followed.normals[v];
            if let Some(tangent) = tangents.get_mut(v) {
                *tangent = followed.tangents[v];
            }
        }
    }

    /// Turns all triangles inside out.
    pub fn turn_inside_out(&mut self) {
        let triangles = self.triangles.iter_mut().chain(&mut self.seamless);
        triangles.for_each(|t| t.swap(1, 2));
    }

    /// The first render vertex of each primitive.
    pub fn first_vertices(&self) -> Vec<u32> {
        self.primitives.iter().map(|p| p.first_vertex).collect()
    }

    /// Appends a primitive without vertices that is as another one is but for its name.
    pub fn add_empty_primitive(&mut self, like: u32, name: &str) {
        self.primitives.push(Primitive {
            name: name.to_owned(),
            first_vertex: self.positions.len() as u32,
            vertex_count: 0,
            index_count: 0,
            ..self.primitives[like as usize].clone()
        });
    }

    /// Appends another surface, whose vertices were put in place before.
    pub fn append(&mut self, other: &EditSurface) {
        let (vertices, primitives) = (self.positions.len() as u32, self.primitives.len() as u32);
        self.seams
            .append(&other.seams, self.positions.len(), other.positions.len());
        let counts = [self.positions.len(), other.positions.len()];
        append_padded(&mut self.normals, &other.normals, counts, Vec3::ZERO);
        append_padded(&mut self.tangents, &other.tangents, counts, Vec4::ZERO);
        self.positions.extend(&other.positions);
        self.triangles
            .extend(other.triangles.iter().map(|t| t.map(|v| v + vertices)));
        self.primitive_of
            .extend(other.primitive_of.iter().map(|p| p + primitives));
        let points = self.points;
        let point = |p: &u32| if *p == NONE { NONE } else { p + points };
        self.point_of.extend(other.point_of.iter().map(point));
        self.points += other.points;
        self.idle_vertices
            .extend(other.idle_vertices.iter().map(|v| v + vertices));
        self.primitives.extend(other.primitives.iter().map(|p| Primitive {
            first_vertex: p.first_vertex + vertices,
            ..p.clone()
        }));
        self.leave_out_seams();
    }
}

/// The vertices of triangles that the mesh left out which are in no other, rising.
fn idle_vertices(mesh: &Mesh, geometry: &Geometry) -> Vec<u32> {
    let left_out = mesh.collapsed_triangles.iter().chain(&mesh.duplicate_triangles);
    let mut found: Vec<u32> = left_out.flat_map(|&t| geometry.triangles[t as usize]).collect();
    if found.is_empty() {
        return found;
    }
    let mut used = vec![false; mesh.solver_from_render.len()];
    for &t in &mesh.source_triangle {
        geometry.triangles[t as usize]
            .iter()
            .for_each(|&v| used[v as usize] = true);
    }
    found.retain(|&v| !used[v as usize]);
    found.sort_unstable();
    found.dedup();
    found
}

/// The primitive of each of `count` triangles.
pub(super) fn triangle_primitives(primitives: &[Primitive], count: usize) -> Vec<u32> {
    let mut of = Vec::with_capacity(count);
    for (p, primitive) in (0u32..).zip(primitives) {
        of.resize((of.len() + primitive.index_count as usize / 3).min(count), p);
    }
    of.resize(count, primitives.len().saturating_sub(1) as u32);
    of
}
