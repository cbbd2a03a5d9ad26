//! The paper's two-pass deformation on a graph.
//!
//! The first pass (section 2.1) finds how every vertex is turned and scaled, by blending the handles' rotations and
//! scales with bounded harmonic fields. The second pass (section 2.2) solves equation (8) for positions that agree best
//! with those local frames. Both solve on one multigrid hierarchy, which depends on the graph alone.
//!
//! Data flows one way: [`Body`] (graph and hierarchy) → [`Rig`] (a set of handles with its fields and systems) →
//! [`Solution`] (positions for the handles' transforms). This module knows no model, no request and no clock.

mod body;
mod carry;
mod equations;
mod error;
mod fields;
mod first_pass;
mod fit;
mod nearest;
mod parts;
mod rig;
mod rotation;
mod second_pass;
mod transform;

pub use body::{Body, BodyOptions, Operators, VolumeMode, Weights};
pub use carry::{Motion, carry};
pub use equations::Equations;
pub use error::Error;
pub use fields::Fields;
pub use first_pass::{Frame, frames};
pub use fit::rigid_fit;
pub use nearest::NearestPoints;
pub use parts::Policy;
pub use rig::{Hold, Rig, Rigging};
pub use rotation::{blend_rotations, exp_rotation, log_rotation};
pub use second_pass::{Cycle, Request, Solution, Start, State};
pub use transform::Transform;
