//! The deformer: a model with its handles, deformed, edited and written by a Rust program that needs no server.
//!
//! This module knows no message, no connection and no clock: `wire` turns messages into its types and back.

mod carry_handles;
mod deformer;
mod derived_structures;
mod digest;
mod edit;
mod edit_operations;
mod handles;
mod interior;
mod mesh_delta;
mod model_topology;
mod quality;
mod region;
mod shading;
mod solve;
mod topology_state;
mod vertex_origins;

pub use deformer::{Deformer, DeformerLimits, HandlePoses};
pub use digest::digest;
pub use edit::{EditCommand, EditOutcome};
pub use shading::{Shader, Shading, shading};
pub use solve::{SolveMode, SolveUpdate, SolvedShape};
pub use topology_state::TopologyState;
