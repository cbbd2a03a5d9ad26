//! The deformer: a model with its handles, deformed, edited and written by a Rust program that needs no server.
//!
//! A [`Deformer`] is opened on a model and builds everything that solving takes. [`Handle`]s hold [`Region`]s of it;
//! [`HandlePose`]s say where handles are; [`Deformer::solve`] answers the shape. An [`Edit`] changes the topology.
//!
//! ```
//! use pliant_core::asset::FileSet;
//! use pliant_core::engine::{Deformer, DeformerLimits, Handle, HandlePose, OpenOptions, Region, SolveSettings};
//! # use pliant_core::{exec::Exec, pool::Pool, progress::Silent};
//! # let (pool, model) = (Pool::new(1)?, sample_model());
//! # let exec = Exec::new(&pool, &Silent);
//! let mut deformer = Deformer::open(model, &OpenOptions::default(), &DeformerLimits::default(), &exec)?;
//! deformer.set_handles(
//!     [
//!         Handle::new("base", Region::half_space([0.0, -1.0, 0.0], 0.9)),
//!         Handle::new("top", Region::half_space([0.0, 1.0, 0.0], 0.9)),
//!     ],
//!     &exec,
//! )?;
//! let shape = deformer.commit([("top", HandlePose::translation([0.5, 0.0, 0.0]))], &SolveSettings::default(), &exec)?;
//! assert_ne!(shape.positions, *deformer.rest());
//! # fn sample_model() -> FileSet { FileSet::single("ball.off", "OFF\n6 8 0\n0 1 0\n1 0 0\n0 0 1\n-1 0 0\n0 0 -1\n0 -1 0\n3 0 2 1\n3 0 3 2\n3 0 4 3\n3 0 1 4\n3 5 1 2\n3 5 2 3\n3 5 3 4\n3 5 4 1\n") }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! This module knows no message, no connection and no clock: `wire` turns messages into its types and back, and checks them
//! on the way. What depends on the model is checked here; an [`Error`] names the field of the request.

mod adopt;
mod animation;
mod buckles;
mod cap_coordinates;
mod carried_handles;
mod carry;
mod clean;
mod contact;
mod deformer;
mod derived_structures;
mod edit;
mod edit_command;
mod edit_operations;
mod edit_surface;
mod error;
mod facts;
mod handle;
mod handle_targets;
mod line_cuts;
mod model_topology;
mod other_model;
mod part_families;
mod quality;
mod region;
mod region_context;
mod resolved_handles;
mod riding;
mod riding_edits;
mod riding_file;
mod riding_frames;
mod seams;
mod settings;
mod shape;
mod solve;
mod stiff;
mod target_vertices;
mod topology_state;
mod transfer;
mod tube_region;
mod unintersect;
mod vertex_targets;
mod wrap;

pub use crate::deform::{Guide, GuidePose, PoseStats, Quality, SolveUpdate};
pub use crate::reference::Method;
pub use adopt::ShapeToEdit;
pub use animation::{
    ANIMATION_QUALITY, AnimatedFrame, Animation, AnimationLimits, BLOCK_FRAMES, BoundModel, ClipRequest, ClipSource,
    FootFacts, FrameChoice, FrameCursor, FrameSource, FrameSums, FrameTimes, MadeRig, PlayedClipFile, PlayedForm,
    RigHandleFacts, RigNodes, RigOrder, WrittenError, bind_model, carrying_joints, influences_of_skin, left_out_of_rig,
    left_out_passengers, left_out_primitives, make_rig, node_place,
};
pub use deformer::Deformer;
pub use edit_command::{
    CleanCommand, Creases, CutLine, Edit, EditCommand, EditKind, EditOutcome, EditReport, EditedShape, KeptVertexRun,
    MergeJoin, ModelMerge, OwnCap, RemeshCommand, SmoothCommand, SmoothKind, UnintersectCommand, UnintersectReport,
};
pub use error::{ESTIMATED_MEMORY, Error};
pub use facts::{
    DeformerFacts, DeformerWarning, HandleFacts, LoosePart, MeshCounts, ModelFacts, QualityReport, SolverFacts,
    TieFacts, WarningPlace,
};
pub use handle::{
    DefaultPivot, Falloff, FalloffCurve, Handle, HandleConstrains, HandlePose, HandlePoses, HandleRotation,
    HandleScale, HandleSet, Stiff,
};
pub use other_model::OtherModel;
pub use quality::FrameQuality;
pub use region::{Anchor, AnchorCorners, Plane, Region, VertexRange};
pub use riding::CarriedNode;
pub use riding_file::RidingFile;
pub use settings::{
    COMMIT_REFINE, CarriedModel, Contact, DeformerLimits, KeptApart, OpenOptions, Passenger, PassengerKind, PoseChain,
    PoseRecipe, Recipe, SolveMode, SolveSettings,
};
pub use shape::{FoundTurn, ModelShape, Shader, Shading, ShapeId, TopologyId, digest, shading};
pub use solve::Drag;
pub use stiff::find_hard_parts;
pub use topology_state::TopologyState;
pub use transfer::{FitFacts, OutfitFit, ShapeFacts, TransferCommand, TransferReport, Transferred};
pub use tube_region::MOST_TUBE_POINTS;
pub use vertex_targets::{StiffnessPer, VertexTargets};
pub use wrap::{LandmarkPlace, WrapCommand, WrapDistances, WrapLandmark, WrapReport};
