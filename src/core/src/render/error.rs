//! Why there is no picture.

/// Why something cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// Positions and triangles are no surface.
    #[error("the surface cannot be drawn: {0}")]
    Surface(crate::mesh::Error),
    /// There is no triangle to see.
    #[error("none of {triangles} triangles has three corners at different places, so there is nothing to draw")]
    Empty {
        /// How many triangles were given.
        triangles: usize,
    },
    /// A side of a view is out of range.
    #[error("the size is {width}x{height}, each side must be {least} to {most} pixels")]
    Size {
        /// Pixels across.
        width: u64,
        /// Pixels down.
        height: u64,
        /// Fewest.
        least: u32,
        /// Most.
        most: u32,
    },
    /// A whole picture is too large.
    #[error("the picture would have {width}x{height} pixels, at most {most} in all are allowed; ask for fewer views")]
    TooLarge {
        /// Pixels across.
        width: u64,
        /// Pixels down.
        height: u64,
        /// Most in all.
        most: u64,
    },
    /// A direction of view is out of range.
    #[error("the view is {azimuth},{elevation}; the azimuth must be -360 to 360 degrees, the elevation -90 to 90")]
    View {
        /// Degrees around the up axis.
        azimuth: f64,
        /// Degrees above the horizon.
        elevation: f64,
    },
    /// Something is not given once for every vertex.
    #[error("{what} for {seen} vertices are given, the surface has {vertices}")]
    Count {
        /// What.
        what: &'static str,
        /// How many were given.
        seen: usize,
        /// How many are needed.
        vertices: usize,
    },
    /// The encoder failed.
    #[error("the picture cannot be written as PNG: {0}")]
    Png(String),
}

impl From<crate::mesh::Error> for Error {
    fn from(e: crate::mesh::Error) -> Self {
        match e {
            crate::mesh::Error::NoTriangle { triangles } => Self::Empty { triangles },
            other => Self::Surface(other),
        }
    }
}
