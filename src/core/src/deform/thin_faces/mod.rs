//! Thin faces: edges and faces far smaller than what is around them follow it, instead of opening.
//!
//! The second pass weighs every edge alike, so it spreads its error over edges evenly, whatever their lengths. An error
//! of a tenth of an edge is harmless to a face of ordinary size, but ten times the height of a thin one.
//! Faces are thin in two ways (Botsch and Kobbelt 2001, "A robust procedure to eliminate degenerate faces"): a needle has
//! an edge far shorter than the others, a cap has a corner close to its longest edge. Vertices on short edges take the
//! mean motion of those around them, corners of caps follow the edge that they lie on. Even meshes have neither and
//! keep all their bits.

mod find;
mod settle;

use crate::mesh::Lists;

/// The thin faces of a mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NeedlesAndCaps {
    /// Vertices with short edges, rising.
    pub(in crate::deform::thin_faces) crowded: Vec<u32>,
    /// For each of them those that it is averaged with.
    pub(in crate::deform::thin_faces) crowds: Lists,
    /// For each of them the distance at which others count no more, in model units.
    pub(in crate::deform::thin_faces) reach: Vec<f64>,
    /// Corners of caps; those over longer edges first, as what they lie on may lie on another.
    pub(in crate::deform::thin_faces) caps: Vec<Cap>,
}

/// A vertex close to an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::deform::thin_faces) struct Cap {
    pub apex: u32,
    pub edge: [u32; 2],
    /// Where on the edge it lies, from 0 at the first end to 1 at the second.
    pub along: f64,
    /// What the edge's motion weighs against its own; infinite for a vertex on the edge.
    pub weight: f64,
}

impl NeedlesAndCaps {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.crowded.is_empty() && self.caps.is_empty()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.crowded.capacity() * 4
            + self.crowds.byte_size()
            + self.reach.capacity() * 8
            + self.caps.capacity() * size_of::<Cap>()
    }
}
