//! Remeshing, subdividing, decimating, welding and stitching: properties that hold on generated shapes and data meshes.

#[path = "edit_remesh/decimating.rs"]
mod decimating;
mod edit_support;
#[path = "edit_remesh/joining.rs"]
mod joining;
#[path = "edit_remesh/measures.rs"]
mod measures;
#[path = "edit_remesh/remeshing.rs"]
mod remeshing;
#[path = "edit_remesh/sequences.rs"]
mod sequences;
#[path = "edit_remesh/subdividing.rs"]
mod subdividing;
