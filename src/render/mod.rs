//! Pictures of triangle meshes without a display: shaded, with wires, or coloured by a number per vertex.
//!
//! Owns the camera, the rasteriser, the colour ramps, letters and PNG bytes. Takes plain slices: it knows no file
//! format, no handle and no job. The same input gives the same bytes for any number of threads.

mod camera;
mod colour;
mod error;
mod font;
mod mark;
mod numbers;
mod picture;
mod plate;
mod raster;
mod surface;

pub use camera::{Camera, Size, Up, View};
pub use colour::{Ramp, Rgb};
pub use error::Error;
pub use mark::Mark;
pub use numbers::{STRETCH_RANGE, displacements, edge_stretch};
pub use picture::Picture;
pub use plate::{Key, Plate};
pub use raster::{draw, ground};
pub use surface::Surface;
