//! What is wrapped onto what.

use crate::deform::BodyOptions;
use crate::mesh::Mesh;
use glam::DVec3;

/// A template and what it is to be wrapped onto.
pub(in crate::engine) struct WrapTask<'a> {
    /// The template's surface, welded.
    pub template: &'a Mesh,
    /// By vertex, whether the caller leaves it out.
    pub masked: &'a [bool],
    pub landmarks: &'a [LandmarkPair],
    /// How bodies are built.
    pub body: &'a BodyOptions,
    /// Whether the result is in the place, and of the size, of the template, not of the target.
    pub in_place: bool,
}

/// A landmark of both surfaces.
#[derive(Debug, Clone, Copy)]
pub(in crate::engine) struct LandmarkPair {
    /// Vertices of the template with weights.
    pub own: [(u32, f64); 3],
    /// Where it is on the target; while a fit runs, over the template.
    pub target: DVec3,
}

impl LandmarkPair {
    /// Where it is on the template.
    pub fn place(&self, positions: &[DVec3]) -> DVec3 {
        self.own.iter().map(|(v, w)| positions[*v as usize] * *w).sum()
    }
}
