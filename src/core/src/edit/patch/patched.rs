//! The surface after an edit, with the maps from and to the one before.

use crate::edit::surface::SurfaceView;
use glam::DVec3;

/// A surface after an edit, and where each part of it comes from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PatchedSurface {
    /// Render vertices.
    pub positions: Vec<DVec3>,
    /// Triangles over render vertices.
    pub triangles: Vec<[u32; 3]>,
    /// The primitive of each triangle, never falling.
    pub primitive_of: Vec<u32>,
    /// The point of each render vertex, or [`NONE`](crate::mesh::NONE).
    pub point_of: Vec<u32>,
    /// How many points there are.
    pub points: u32,
    /// The first render vertex of each primitive; a primitive that lost all its vertices has an empty run.
    pub first_vertex: Vec<u32>,
    /// For each old render vertex its number now, or [`NONE`](crate::mesh::NONE) when it is gone.
    pub vertex_from_old: Vec<u32>,
    /// For each old point its number now (that of the point that it joined), or [`NONE`](crate::mesh::NONE) when it is gone.
    pub point_from_old: Vec<u32>,
    /// For each render vertex what it was: an old number, or the number of old vertices plus an index into
    /// [`SurfacePatch::vertices`](super::SurfacePatch::vertices).
    pub old_from_vertex: Vec<u32>,
    /// For each point the old number, or [`NONE`](crate::mesh::NONE) when it is new.
    pub old_from_point: Vec<u32>,
    /// For each triangle the old number, or [`NONE`](crate::mesh::NONE) when it is new.
    pub old_from_triangle: Vec<u32>,
}

impl PatchedSurface {
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
