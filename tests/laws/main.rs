//! Laws of meshes, graphs and deformation, on generated shapes and on models of the data folder.

mod borders;
mod drag;
mod engine_examples;
mod equivariance;
mod first_pass;
mod free_turns;
mod graph;
mod graph_resample;
mod handle_options;
mod handles;
mod mesh;
mod paper;
mod refinement;
mod solver_slivers;
mod stiff_parts;
#[path = "../support/mod.rs"]
mod support;
mod when_set;
