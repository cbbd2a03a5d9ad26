//! Mesh deformation for Rust programs, without a server: from the bytes of a model to those of its deformed shape.
//!
//! [`engine`] is the way in: a [`engine::Deformer`] holds a model with its volume graph, hierarchy and handles, solves
//! poses, follows edits and writes the model again. The modules below it serve alone as well.
//!
//! | module | what |
//! |---|---|
//! | [`engine`] | the deformer: typed handles, regions, poses and edits |
//! | [`deform`], [`edit`], [`motion`], [`render`] | two passes: rotation fields, positions; topology operations; clips and skeletons; pictures |
//! | [`asset`], [`mesh`], [`graph`] | model formats; triangles; surface and volume graphs |
//! | [`solver`], [`exec`] | multigrid on a weighted graph; threads, progress and cancelling |
//!
//! All but [`engine`] are crates of their own, re-exported here.
//!
//! No module reads a clock, a file or the network, and the same inputs give the same bits for any number of threads.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

pub mod engine;

pub use pliant_asset as asset;
pub use pliant_deform as deform;
pub use pliant_edit as edit;
pub use pliant_exec as exec;
pub use pliant_exec::{pool, progress};
pub use pliant_mesh as mesh;
pub use pliant_mesh::graph;
pub use pliant_motion as motion;
pub use pliant_reference as reference;
pub use pliant_render as render;
pub use pliant_solver as solver;
