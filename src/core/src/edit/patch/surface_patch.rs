//! What an edit changes.

use glam::DVec3;

/// A vertex that an edit makes.
#[derive(Debug, Clone, PartialEq)]
pub struct NewVertex {
    /// The primitive that it belongs to.
    pub primitive: u32,
    /// Its point: an old one, or, from [`SurfaceView::points`](crate::edit::SurfaceView::points) on, a new one. New points are numbered in the order in which
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
    /// Old vertices that no triangle of the surface uses and that go as well, rising: others of that kind stay.
    pub idle: Vec<u32>,
    /// What the user should know.
    pub warnings: Vec<EditWarning>,
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
