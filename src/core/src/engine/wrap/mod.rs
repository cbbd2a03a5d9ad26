//! A template wrapped onto a target: a model with its topology, texture coordinates, rig and morph targets takes the shape of another
//! surface, mostly a scan with noise and holes (non-rigid iterated closest points, after Amberg et al. 2007, with rotations fitted
//! at every vertex in place of affine maps).
//!
//! `surface` makes a `task` of what is asked for, `run` does it: a `similarity` puts the target over the template, by landmarks or by the shapes (`place`). `fit` solves for landmarks alone, and then for closest
//! points that face the same way (`facing`), pulled harder from level to level; `target` knows where the scan ends, `visible` what can
//! be seen, `two_way` what of the target pulls the template. `report` measures.

mod command;
mod facing;
mod fit;
mod normals;
mod place;
mod queries;
mod report;
mod run;
mod similarity;
mod surface;
mod target;
mod task;
mod two_way;
mod visible;

pub use command::{LandmarkPlace, WrapCommand, WrapLandmark};
pub(super) use facing::{LEAST_COSINE, OrientedPoint};
pub(super) use queries::answers;
pub(super) use report::edge_distortion;
pub use report::{WrapDistances, WrapReport};
pub(super) use run::{WRAPPED_BYTES, wrap};
pub(super) use surface::{LandmarkSurfaces, SurfaceWrapping, turn_outwards};
pub(super) use target::barycentric;
pub(super) use task::WrapTask;
