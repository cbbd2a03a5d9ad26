//! Remeshing, subdividing, decimating, welding and stitching: properties that hold on generated shapes and data meshes.

mod decimating;
use super::edit_support;
mod joining;
mod keeping;
mod measures;
mod remeshing;
mod sequences;
mod subdividing;
