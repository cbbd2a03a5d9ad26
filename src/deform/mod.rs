//! The paper's two-pass deformation on a graph.
//!
//! The first pass (section 2.1) finds how every vertex is turned and scaled, by blending the handles' rotations and
//! scales with bounded harmonic fields. The second pass (section 2.2) solves equation (8) for positions that agree best
//! with those local frames. Both solve on one multigrid hierarchy, which depends on the graph alone. Beyond the paper,
//! [`Refinement`] fits the frames to the result and solves again.
//!
//! Data flows one way: [`DeformableBody`] (graph and hierarchy) → [`HandleSystem`] (a set of handles with its fields and
//! systems) → [`PoseSolution`] (positions for the handles' transforms). This module knows no model, no request and no clock.
//!
//! | room | what |
//! |---|---|
//! | `body`, `edited_body` | graph, hierarchy and rest shape of a mesh, and how they follow an edit |
//! | `handles` | which handle holds which node, loose parts, how nodes are carried along and placed |
//! | `fields` | bounded harmonic fields of the handles, and how they begin again after an edit |
//! | `rotation` | rotation vectors, fits and blends of rotations |
//! | `first_pass` | the local frame of each node |
//! | `second_pass` | equation (8), solving it, and fitting rotations to the result |
//! | `comparison` | other methods, to compare with: orientation diffusion, linear frames, radial basis functions |

mod body;
mod comparison;
mod edited_body;
mod error;
mod fields;
mod first_pass;
mod handles;
mod rotation;
mod second_pass;
mod transform;

pub use body::{BodyOptions, CoarseOperators, DeformableBody, EdgeWeights, VolumeMode};
pub use edited_body::EditedBody;
pub use error::Error;
pub use fields::{FieldRestart, HarmonicFields, KeptFields};
pub use first_pass::{FirstPass, LocalFrame, frames};
pub use handles::{FreePartPolicy, HandleConstraint, HandleMotion, HandleSetup, HandleSystem, carry};
pub use rotation::{blend_rotations, exp_rotation, fit_rigid_motion, log_rotation};
pub use second_pass::{
    CycleReport, PoseMethod, PoseRequest, PoseSolution, Refinement, SecondPassEquations, SolveStart, SolveState,
};
pub use transform::Transform;
