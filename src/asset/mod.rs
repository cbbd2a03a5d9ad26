//! Models in and out of bytes, byte-faithful: glTF and GLB, OBJ, PLY, OFF, STL.
//!
//! Owns formats. Knows nothing of welding, graphs or solving. A [`Model`] keeps the uploaded files; writing it with new
//! positions changes those places only that the deformation changed.
//!
//! Each format has a reader (bytes to [`Geometry`] and what the writer must remember), a writer that edits the uploaded
//! bytes in place, a builder that makes a fresh file from a model of another format, and a writer for models whose
//! triangles an edit has remade ([`Remade`]), which takes every attribute along. [`sample`] and [`shapes`] make models
//! where no file is at hand.

mod error;
mod files;
mod format;
mod geometry;
mod gltf;
mod model;
mod obj;
mod off;
mod plain;
mod ply;
mod polygons;
mod remade;
pub mod sample;
pub mod shapes;
mod stl;
mod surface_nets;
mod text;

pub use error::Error;
pub use files::{FileSet, Limits, Written};
pub use format::Format;
pub use geometry::Geometry;
pub use model::{Model, Primitive};
pub use remade::{Base, Recipe, Recipes, Remade, Run, write_remade};
