//! Why triangles cannot become a mesh.

/// Why slices of positions and triangles are not a mesh that can be solved on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A vertex that a triangle uses lies nowhere, or outside what 32-bit frames can carry.
    #[error("vertex {vertex} lies at {seen}, each coordinate must be a finite number within ±{limit:e}", limit = f32::MAX)]
    Position {
        /// The render vertex.
        vertex: usize,
        /// Its position as read.
        seen: glam::DVec3,
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {index}, there are {vertices} vertices, counted from 0")]
    Index {
        /// The triangle, counted from 0.
        triangle: usize,
        /// The index it holds.
        index: u32,
        /// How many vertices there are.
        vertices: usize,
    },
    /// The weld tolerance is not a length.
    #[error("weld tolerance is {seen}, it must be finite and at least 0")]
    Tolerance {
        /// The value given.
        seen: f64,
    },
    /// More than 32-bit indices can name.
    #[error("{seen} {what}, at most {limit} can be numbered")]
    TooLarge {
        /// What there is too much of.
        what: &'static str,
        /// How many there are.
        seen: usize,
        /// How many are allowed.
        limit: usize,
    },
    /// Nothing is left to solve on.
    #[error("none of {triangles} triangles has three distinct corners; a smaller weld tolerance may keep some")]
    NoTriangle {
        /// How many triangles were given.
        triangles: usize,
    },
}
