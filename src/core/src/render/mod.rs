//! Pictures of triangle meshes without a display: shaded, with wires, coloured by a number per vertex, or in the model's own
//! base colours.
//!
//! The module owns the camera, the rasteriser, the colour ramps, letters and PNG bytes. It takes plain slices and
//! looks ([`crate::asset::SurfaceLook`]), and knows no file format, no handle and no job. The same input gives the same bytes for any number of threads.
//!
//! ```
//! use glam::DVec3;
//! use pliant_core::pool::Pool;
//! use pliant_core::render::{Camera, PictureSize, ShadedSurface, UpAxis, ViewDirection, draw_surface};
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

mod camera;
mod colour;
mod colour_key;
mod dress;
mod error;
mod font;
mod picture;
mod raster;
mod ring_mark;
mod surface;
mod texture;
mod view_sheet;

pub use camera::{Camera, PictureSize, UpAxis, ViewDirection};
pub use colour::{ColourRamp, Rgb};
pub use colour_key::ColourKey;
pub use dress::SurfaceDress;
pub use dress::{STRETCH_RANGE, edge_stretch, vertex_displacements};
pub use error::Error;
pub use picture::{Picture, encode_moving_png};
pub use raster::{background_end, draw_surface};
pub use ring_mark::RingMark;
pub use ring_mark::{BoneMarks, POSITION_COLOUR, ROTATION_COLOUR};
pub use surface::ShadedSurface;
pub use surface::{DrawnBall, open_surface};
pub use texture::Texture;
pub use view_sheet::ViewSheet;
