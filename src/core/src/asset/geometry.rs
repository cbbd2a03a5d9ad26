//! What every reader hands back: the mesh that the file describes, free of its format.

use super::{Error, Format, Limits};
use crate::mesh::shading;
use glam::{DVec3, Vec3, Vec4};
use std::ops::Range;

/// One run of render vertices: a glTF primitive under one node, or the whole of any other format.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Primitive {
    /// Index of the node that places it; 0 without nodes.
    pub node: u32,
    /// Index of its mesh in the file; 0 without meshes.
    pub mesh: u32,
    /// Index inside that mesh.
    pub primitive: u32,
    /// Name of the node, else of the mesh, else empty.
    pub name: String,
    /// Its first render vertex.
    pub first_vertex: u32,
    /// Number of its render vertices.
    pub vertex_count: u32,
    /// Number of its triangle-corner indices after conversion to triangles (three per triangle).
    pub index_count: u32,
    /// Whether the model gives normals for it.
    pub has_normals: bool,
    /// Whether the model gives tangents for it.
    pub has_tangents: bool,
    /// Whether it is not solved, but follows the solved surface.
    pub is_passenger: bool,
}

impl Primitive {
    /// Its render vertices.
    pub fn vertices(&self) -> Range<usize> {
        let first = self.first_vertex as usize;
        first..first.saturating_add(self.vertex_count as usize)
    }
}

/// Render vertices, triangles and primitives of a model, whatever format they came in.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Geometry {
    /// Render vertices in model (world) space, in the order of `primitives`.
    pub positions: Vec<DVec3>,
    /// Authored unit normals in model space, one per render vertex (zero where a primitive has none); empty when no
    /// primitive has any.
    pub normals: Vec<Vec3>,
    /// Authored tangents (xyz unit, w handedness) in model space; as `normals`.
    pub tangents: Vec<Vec4>,
    /// Triangles over render vertices, in file order; polygons, strips and fans are converted.
    pub triangles: Vec<[u32; 3]>,
    /// The runs of render vertices.
    pub primitives: Vec<Primitive>,
    /// Places where the reader had to choose: (code, message, where). None is fatal.
    pub warnings: Vec<(String, String, String)>,
}

impl Geometry {
    /// The geometry of a format that knows one mesh only: a single primitive with all vertices. `normals` is empty or
    /// has one per position.
    pub(super) fn from_one_mesh(positions: Vec<DVec3>, normals: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Self {
        let primitive = Primitive {
            vertex_count: positions.len() as u32,
            index_count: (triangles.len() * 3) as u32,
            has_normals: !normals.is_empty(),
            ..Primitive::default()
        };
        Self {
            positions,
            normals,
            triangles,
            primitives: vec![primitive],
            ..Self::default()
        }
    }

    pub(super) fn warn(&mut self, code: &str, message: impl Into<String>, place: impl Into<String>) {
        self.warnings.push((code.into(), message.into(), place.into()));
    }

    /// Warns of concave polygons that were cut into a plain fan.
    pub(super) fn warn_about_crude_polygons(&mut self, count: usize) {
        if count > 0 {
            self.warn(
                "polygon-too-large",
                format!("{count} polygons are too large to cut into triangles well"),
                "",
            );
        }
    }

    /// What every reader promises, checked once for all of them.
    pub(super) fn check(&self, format: Format, limits: &Limits) -> Result<(), Error> {
        let count = self.positions.len();
        limits.check_vertices(count as u64)?;
        limits.check_triangles(self.triangles.len() as u64)?;
        let malformed = |place, problem| Err(Error::Malformed { format, place, problem });
        if let Some(i) = self.positions.iter().position(|p| !p.is_finite()) {
            let problem = format!("the position is {}; finite coordinates are needed", self.positions[i]);
            return malformed(format!("vertex {i}"), problem);
        }
        if let Some(i) = self
            .triangles
            .iter()
            .position(|t| t.iter().any(|&v| v as usize >= count))
        {
            let problem = format!("vertices {:?} are named, there are {count}", self.triangles[i]);
            return malformed(format!("triangle {i}"), problem);
        }
        if self.triangles.is_empty() {
            return Err(Error::NoMesh {
                format,
                problem: format!("{count} vertices and no triangle"),
            });
        }
        Ok(())
    }

    /// The same geometry at new positions, normals and tangents carried along.
    pub(super) fn deformed(&self, positions: &[DVec3]) -> Self {
        let mut moved = self.clone();
        moved.positions.copy_from_slice(positions);
        if !self.normals.is_empty() {
            let triangles = &self.triangles;
            let gradients = shading::gradients(&self.positions, positions, triangles, triangles, positions.len());
            for (i, gradient) in gradients.iter().enumerate() {
                let Some(gradient) = gradient else { continue };
                moved.normals[i] = shading::carry_normal(gradient, self.normals[i]);
                if let Some(tangent) = moved.tangents.get_mut(i) {
                    *tangent = shading::carry_tangent(gradient, *tangent, moved.normals[i]);
                }
            }
        }
        moved
    }

    /// About how many bytes it holds in memory.
    pub fn bytes_held(&self) -> u64 {
        let arrays = size_of_val(self.positions.as_slice())
            + size_of_val(self.normals.as_slice())
            + size_of_val(self.tangents.as_slice())
            + size_of_val(self.triangles.as_slice())
            + size_of_val(self.primitives.as_slice());
        arrays as u64
    }

    /// The runs of triangles that belong to each primitive, in order.
    pub fn triangles_of_primitives(&self) -> impl Iterator<Item = (&Primitive, &[[u32; 3]])> {
        let mut rest = self.triangles.as_slice();
        self.primitives.iter().map(move |primitive| {
            let (run, after) = rest.split_at((primitive.index_count as usize / 3).min(rest.len()));
            rest = after;
            (primitive, run)
        })
    }

    /// Whether every render vertex that a triangle uses has a normal, so that a format with one flag for all can hold them.
    pub(super) fn all_have_normals(&self) -> bool {
        self.normals.len() == self.positions.len()
            && self.primitives.iter().all(|p| p.has_normals || p.vertex_count == 0)
    }
}

/// A normal of unit length; zero for one that is zero or not finite, which stands for none.
pub(super) fn unit_or_zero(normal: DVec3) -> Vec3 {
    let size = normal.abs().max_element();
    let scaled = if size > 0.0 && size.is_finite() {
        normal / size
    } else {
        return Vec3::ZERO;
    };
    scaled.try_normalize().map_or(Vec3::ZERO, |n| n.as_vec3())
}
