//! Pictures of triangle meshes without a display: shaded, with wires, coloured by a number per vertex, or in the model's own
//! base colours.
//!
//! The crate owns the camera, the rasteriser, the colour ramps, letters and PNG bytes. It takes plain slices and
//! looks ([`pliant_asset::SurfaceLook`]), and knows no file format, no handle and no job. The same input gives the same bytes for any number of threads.
//!
//! ```
//! use glam::DVec3;
//! use pliant_exec::pool::Pool;
//! use pliant_render::{Camera, PictureSize, ShadedSurface, UpAxis, ViewDirection, draw_surface};
//!
//! let pool = Pool::new(1)?;
//! let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
//! let surface = ShadedSurface::new(&corners, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], &pool)?;
//! let view = ViewDirection::new(30.0, 20.0, UpAxis::Y)?;
//! let cameras = Camera::around_surfaces(&[&surface], &[view], PictureSize::new(64, 48)?);
//! let png = draw_surface(&surface, &cameras[0], &pool).encode_png()?;
//! assert!(png.starts_with(b"\x89PNG"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod camera;
mod caption;
mod colour;
mod colour_key;
mod dress;
mod font;
mod picture;
mod raster;
mod ring_mark;
mod surface;
mod texture;
mod view_sheet;

pub use camera::{Camera, PictureSize, UpAxis, ViewDirection};
pub use caption::Caption;
pub use colour::{ColourRamp, Rgb, crossing_colour};
pub use colour_key::ColourKey;
pub use dress::{STRETCH_RANGE, SurfaceDress, edge_stretch, vertex_displacements};
pub use picture::{INK, Picture, encode_moving_png};
pub use raster::{background_end, draw_surface};
pub use ring_mark::{BoneMarks, POSITION_COLOUR, ROTATION_COLOUR, RingMark};
pub use surface::{DrawnBall, ShadedSurface, open_surface};
pub use texture::Texture;
pub use view_sheet::{CloseView, SheetShape, ViewSheet, sheet_columns};

/// Why something cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// Positions and triangles are no surface.
    #[error("the surface cannot be drawn: {0}")]
    Surface(pliant_mesh::Error),
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

impl From<pliant_mesh::Error> for Error {
    fn from(e: pliant_mesh::Error) -> Self {
        match e {
            pliant_mesh::Error::NoTriangle { triangles } => Self::Empty { triangles },
            other => Self::Surface(other),
        }
    }
}
