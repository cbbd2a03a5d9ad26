//! The paper's two-pass deformation on a graph.
//!
//! The first pass (section 2.1) finds how every vertex is turned and scaled, by blending the handles' rotations and
//! scales with bounded harmonic fields. The second pass (section 2.2) solves equation (8) for positions that agree best
//! with those local frames. Both solve on one multigrid hierarchy, which depends on the graph alone. Beyond the paper,
//! the frames are fitted to the result and it is solved again, [`Quality::refine`] times.
//!
//! Data flows one way: [`DeformableBody`] (graph and hierarchy) → [`HandleSystem`] (a set of handles with its fields and
//! systems) → [`SolvedNodes`] (positions for the handles' transforms). This crate knows no model, no request and no clock.
//!
//! ```
//! use glam::DVec3;
//! use pliant_asset::shapes::box_with_cells;
//! use pliant_deform::*;
//! use pliant_exec::Exec;
//! use pliant_mesh::{Mesh, Weld};
//! use pliant_exec::pool::Pool;
//! use pliant_exec::progress::Silent;
//!
//! let (positions, triangles) = box_with_cells(DVec3::ONE, [4, 4, 4]);
//! let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a box");
//! let pool = Pool::new(1).expect("a thread");
//! let exec = Exec::new(&pool, &Silent);
//! let body = DeformableBody::build(&mesh, &BodyOptions::default(), &exec)?;
//!
//! // The lowest vertices stay where they are, the highest ones move up.
//! let (low, high) = (mesh.bounds().min.y, mesh.bounds().max.y);
//! let handle_at = |y: f64| HandleConstraint {
//!     nodes: (0u32..).zip(&mesh.positions).filter(|(_, p)| p.y == y).map(|(node, _)| node).collect(),
//!     position: true,
//!     rotation: true,
//!     ..Default::default()
//! };
//! let setup = HandleSetup { handles: vec![handle_at(low), handle_at(high)], ..Default::default() };
//! let handles = HandleSystem::build(&body, setup, &exec)?;
//! let up = Transform { translation: DVec3::Y, ..Transform::IDENTITY };
//! let transforms = [Transform::IDENTITY, up];
//! let request = PoseRequest::new(&transforms, Quality::default());
//! let solved = handles.solve(&body, &request, &mut SolveState::default(), &exec, &mut |_| true)?;
//! for (p, now) in mesh.positions.iter().zip(&solved.positions) {
//!     assert!(now.y >= p.y - 1e-3 && now.y <= p.y + 1.001);
//!     assert!(p.y != high || *now == *p + DVec3::Y);
//! }
//! # Ok::<(), Error>(())
//! ```
//!
//! | module | what |
//! |---|---|
//! | `body` | graph, hierarchy and rest shape of a mesh, and how they follow an edit |
//! | `handles` | which handle holds which node, loose parts, how nodes are carried along and placed |
//! | `fields` | bounded harmonic fields of the handles |
//! | `field_solver` | solves for them |
//! | `field_terms` | what poses give to handles, with their fields |
//! | `local_fields` | those of many handles, each around its own |
//! | `shares` | by node, the handles that have a say there |
//! | `joints` | where handles turn about by default |
//! | `rotation` | transforms of handles, fits and blends of rotations |
//! | `first_pass` | the local frame of each node |
//! | `pose` | what a pose is to come to: [`PoseRequest`], [`Quality`], [`SolvedNodes`] |
//! | `solve` | [`HandleSystem::solve`], which does both passes |
//! | `second_pass` | equation (8), fitting rotations to its result, and poses of a drag |
//! | `guides` | curves, lattices and cages whose shape says where vertices are wanted |
//! | `thin_faces` | needles and caps, which follow the shape around them |
//! | `folds` | faces that turned over, brought back where nothing forces them |
//! | `contact` | surfaces that cross, moved apart |
//! | `surface_transfer` | shapes of one surface, carried to another with the same triangles |
//! | `surface_faults` | folds and crossings of a shape, counted |

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod body;
mod border_frames;
mod contact;
mod error;
mod field_solver;
mod field_terms;
mod fields;
mod first_pass;
mod fold_suspects;
mod folds;
mod guides;
mod handles;
mod joints;
mod local_fields;
mod pose;
mod rotation;
mod second_pass;
mod shares;
mod solve;
mod surface_faults;
mod surface_transfer;
mod thin_faces;
mod volume_scales;

pub use body::{BodyOptions, CoarseOperators, DeformableBody, EdgeWeights, TieFamilies, TieOptions, VolumeMode};
pub use contact::{
    ContactMemory, ContactSurface, CrossingSurface, FittedOutfit, LayerSides, MOST_PARTED, MovingSurface, OutfitFaults,
    OutfitOnBody, PosePath, RestCrossings, UncrossedSurface,
};
pub use error::Error;
pub use fields::{HarmonicFields, MOST_WHOLE_FIELDS};
pub use first_pass::{LocalFrame, LocalRotation, PoseBlend, frames, pack_rotation};
pub use folds::{FaceChanges, FaceSurroundings, unfold_faces, unfold_suspects, unfold_vertices};
pub use guides::{BoundGuide, Guide, GuidePose, GuideProblem};
pub use handles::{
    FreePartPolicy, HandleConstraint, HandleMotion, HandleSetup, HandleShares, HandleSystem, HoldTargets,
    NodeOwnership, PulledPoint, StiffNodes, UNHELD, carry, shares_difference,
};
pub use pose::{
    FirstPass, FitOrder, PoseRequest, PoseStats, Quality, SolutionExtent, SolveStart, SolveUpdate, SolvedNodes,
};
pub use rotation::{Transform, blend_rotations, exp_rotation, fade, fit_rigid_motion, log_rotation};
pub use second_pass::{SecondPassEquations, SolveState, TurnChange, TurnChangeKind};
pub use surface_faults::{FreeSurface, SurfaceFaults};
pub use surface_transfer::{CarriedMotion, SurfaceTransfer};
pub use thin_faces::NeedlesAndCaps;
pub use volume_scales::VolumeScales;
