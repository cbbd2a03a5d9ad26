//! The paper's two-pass deformation on a graph.
//!
//! The first pass (section 2.1) finds how every vertex is turned and scaled, by blending the handles' rotations and
//! scales with bounded harmonic fields. The second pass (section 2.2) solves equation (8) for positions that agree best
//! with those local frames. Both solve on one multigrid hierarchy, which depends on the graph alone. Beyond the paper,
//! [`Refinement`] fits the frames to the result and solves again.
//!
//! Data flows one way: [`Body`] (graph and hierarchy) → [`Rig`] (a set of handles with its fields and systems) →
//! [`Solution`] (positions for the handles' transforms). This module knows no model, no request and no clock.

mod blending;
mod body;
mod carry;
mod cholesky;
mod diffusion;
mod equations;
mod error;
mod fields;
mod first_pass;
mod fit;
mod follow;
mod linear_frames;
mod nearest;
mod parts;
mod placing;
mod refine;
mod restart;
mod rig;
mod rotation;
mod second_pass;
mod spatial_rbf;
mod transform;

pub use blending::blend_rotations;
pub use body::{Body, BodyOptions, Operators, VolumeMode, Weights};
pub use carry::{Motion, carry};
pub use equations::Equations;
pub use error::Error;
pub use fields::Fields;
pub use first_pass::{FirstPass, Frame, frames};
pub use fit::rigid_fit;
pub use follow::Followed;
pub use nearest::NearestPoints;
pub use parts::Policy;
pub use refine::Refinement;
pub use restart::{KeptFields, Restart};
pub use rig::{Hold, Rig, Rigging};
pub use rotation::{exp_rotation, log_rotation};
pub use second_pass::{Cycle, Method, Request, Solution, Start, State};
pub use transform::Transform;
