//! What an edit reads and what it answers.

use glam::DVec3;

/// The surface that an edit works on. Render vertices and triangles in file order; triangles of one primitive stand
/// together, primitives in rising order.
#[derive(Debug, Clone, Copy)]
pub struct Surface<'a> {
    /// Render vertices, in the shape that the edit is to see.
    pub positions: &'a [DVec3],
    /// Triangles over render vertices.
    pub triangles: &'a [[u32; 3]],
    /// The primitive of each triangle, never falling.
    pub primitive_of: &'a [u32],
    /// The point of each render vertex; [`NONE`](crate::mesh::NONE) where no triangle uses it. Vertices of one point
    /// have the same position.
    pub point_of: &'a [u32],
    /// How many points there are.
    pub points: u32,
}

/// A vertex that an edit makes.
#[derive(Debug, Clone, PartialEq)]
pub struct NewVertex {
    /// The primitive that it belongs to.
    pub primitive: u32,
    /// Its point: an old one, or, from [`Surface::points`] on, a new one. New points are numbered in the order in which
    /// the new vertices first name them, without gaps.
    pub point: u32,
    /// Where it is.
    pub position: DVec3,
    /// The old render vertices, of the same primitive, that its attributes are blended from. Entries of weight 0 are
    /// ignored; the weights are not negative and sum to 1.
    pub of: [u32; 3],
    /// Their weights.
    pub weights: [f64; 3],
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
pub struct Patch {
    /// Triangles that go, by number, rising, each once. Vertices and points that lose their last triangle go as well.
    pub removed: Vec<u32>,
    /// Vertices that come, numbered on from the old ones.
    pub vertices: Vec<NewVertex>,
    /// Triangles that come.
    pub triangles: Vec<NewTriangle>,
    /// Old points that move, with all their render vertices: point and new position, rising, each once.
    pub moved: Vec<(u32, DVec3)>,
    /// Old points that become one with another: point and the old point that it joins, which joins no other; rising,
    /// each once. The joined vertices take the position of the point that stays.
    pub joined: Vec<(u32, u32)>,
    /// Old vertices that no triangle of the surface uses and that go as well, rising: others of that kind stay.
    pub idle: Vec<u32>,
    /// What the user should know: code, message, place.
    pub warnings: Vec<(String, String, String)>,
}
