//! What an edit changes, and the surface after it, with the maps from and to the one before.

use crate::surface::SurfaceView;
use glam::DVec3;
use pliant_mesh::NONE;

/// A surface after an edit, and where each part of it comes from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PatchedSurface {
    /// Render vertices.
    pub positions: Vec<DVec3>,
    /// Triangles over render vertices.
    pub triangles: Vec<[u32; 3]>,
    /// The primitive of each triangle, never falling.
    pub primitive_of: Vec<u32>,
    /// The point of each render vertex, or [`NONE`](pliant_mesh::NONE).
    pub point_of: Vec<u32>,
    /// How many points there are.
    pub points: u32,
    /// The first render vertex of each primitive; a primitive that lost all its vertices has an empty run.
    pub first_vertex: Vec<u32>,
    /// For each old render vertex its number now, or [`NONE`](pliant_mesh::NONE) when it is gone.
    pub vertex_from_old: Vec<u32>,
    /// For each old point its number now (that of the point that it joined), or [`NONE`](pliant_mesh::NONE) when it is gone.
    pub point_from_old: Vec<u32>,
    /// For each render vertex what it was: an old number, or the number of old vertices plus an index into
    /// [`SurfacePatch::vertices`](super::SurfacePatch::vertices).
    pub old_from_vertex: Vec<u32>,
    /// For each point the old number, or [`NONE`](pliant_mesh::NONE) when it is new.
    pub old_from_point: Vec<u32>,
    /// For each triangle the old number, or [`NONE`](pliant_mesh::NONE) when it is new.
    pub old_from_triangle: Vec<u32>,
}

impl PatchedSurface {
    /// The first render vertex of each of some points.
    ///
    /// # Panics
    /// When there is no such point.
    pub fn vertices_of_points(&self, points: &[u32]) -> Vec<u32> {
        if points.is_empty() {
            return Vec::new();
        }
        let mut vertex_of = vec![NONE; self.points as usize];
        // From the last to the first, so that the first vertex of each point stays.
        for (vertex, &p) in self.point_of.iter().enumerate().rev() {
            if p != NONE {
                vertex_of[p as usize] = vertex as u32;
            }
        }
        points.iter().map(|&p| vertex_of[p as usize]).collect()
    }

    /// The surface to edit next.
    pub fn surface(&self) -> SurfaceView<'_> {
        SurfaceView {
            positions: &self.positions,
            triangles: &self.triangles,
            primitive_of: &self.primitive_of,
            point_of: &self.point_of,
            points: self.points,
        }
    }
}

/// A vertex that an edit makes.
#[derive(Debug, Clone, PartialEq)]
pub struct NewVertex {
    /// The primitive that it belongs to.
    pub primitive: u32,
    /// Its point: an old one, or, from [`SurfaceView::points`](crate::SurfaceView::points) on, a new one. New points are numbered in the order in which
    /// the new vertices first name them, without gaps. [`NONE`](pliant_mesh::NONE) for one of a line beside the surface, which is
    /// in no triangle.
    pub point: u32,
    /// Where it is.
    pub position: DVec3,
    /// The old render vertices, of the same primitive or, for one of [`SurfacePatch::caps`], the one that it is given, that
    /// its attributes are blended from. Entries of weight 0 are
    /// ignored; the weights are not negative and sum to 1.
    pub of: [u32; 3],
    /// Their weights.
    pub weights: [f64; 3],
}

impl NewVertex {
    /// The render vertices that it is blended from, with their weights, which are above 0.
    pub fn parts(&self) -> impl Iterator<Item = (u32, f64)> + Clone {
        self.of.into_iter().zip(self.weights).filter(|part| part.1 > 0.0)
    }
}

/// An old vertex that stays and takes other attributes: its point has slid along the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlendedVertex {
    /// The vertex.
    pub vertex: u32,
    /// As [`NewVertex::of`].
    pub of: [u32; 3],
    /// As [`NewVertex::weights`].
    pub weights: [f64; 3],
    /// Whether it shows the normal of its triangle instead of a blended one.
    pub flat: bool,
}

impl BlendedVertex {
    /// The render vertices that it is blended from, with their weights, which are above 0.
    pub fn parts(&self) -> impl Iterator<Item = (u32, f64)> + Clone {
        self.of.into_iter().zip(self.weights).filter(|part| part.1 > 0.0)
    }
}

/// A triangle that an edit makes. A corner below the number of old render vertices is an old one, else it is a new one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NewTriangle {
    /// The primitive that it belongs to; that of all its corners.
    pub primitive: u32,
    /// Its corners.
    pub corners: [u32; 3],
}

/// What an edit changes. What it does not name stays as it is.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurfacePatch {
    /// Triangles that go, by number, rising, each once. Vertices and points that lose their last triangle go as well.
    pub removed: Vec<u32>,
    /// Vertices that come, numbered on from the old ones.
    pub vertices: Vec<NewVertex>,
    /// Those of them, by place, rising, that show the normal of their triangle instead of a blended one.
    pub flat: Vec<u32>,
    /// Triangles that come.
    pub triangles: Vec<NewTriangle>,
    /// Old points that move, with all their render vertices: point and new position, rising, each once.
    pub moved: Vec<(u32, DVec3)>,
    /// Old points that become one with another: point and the old point that it joins, which joins no other; rising,
    /// each once. The joined vertices take the position of the point that stays.
    pub joined: Vec<(u32, u32)>,
    /// Old vertices that stay and take other attributes, rising, each once.
    pub blended: Vec<BlendedVertex>,
    /// Old vertices that no triangle of the surface uses and that go as well, rising: others of that kind stay.
    pub idle: Vec<u32>,
    /// What the user should know.
    pub warnings: Vec<EditWarning>,
    /// Points along an inserted curve, in order, in the numbers after the edit.
    pub curve: Vec<u32>,
    /// Primitives that come, after the old ones, and the old primitives whose vertices theirs are blended from.
    pub caps: Vec<(u32, u32)>,
    /// Edges that stay sharp in a subdivision, by their ends, in the numbers after the edit.
    pub creases: Vec<[u32; 2]>,
    /// Of a remesh or relaxation: the largest distance between the surface before and after.
    pub deviation: f64,
    /// Of a smoothing: by which part of the volume of the surface it changes.
    pub volume_change: f64,
}

/// Something that the user should know about an edit that was done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EditWarning {
    /// Says to programs what it is, for example `open-section`.
    pub code: String,
    /// Says it to people.
    pub message: String,
    /// Where on the surface it is.
    pub place: String,
}

impl EditWarning {
    /// Makes a warning.
    pub fn new(code: &str, message: impl Into<String>, place: impl Into<String>) -> Self {
        Self {
            code: code.to_owned(),
            message: message.into(),
            place: place.into(),
        }
    }
}
