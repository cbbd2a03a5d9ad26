//! The wire: messages of the schema, their JSON, and what they mean as values of [`pliant_core::engine`].
//!
//! Everything that a client can ask is a message of [`pb`]. This crate is the only one that checks the form of what clients send; a
//! refusal names the field as clients write it. It knows no session, no connection and no clock.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod anchors;
mod animate;
mod calls;
mod check;
mod create;
mod crossings;
mod edit;
mod facts;
pub mod frames;
mod guides;
mod handles;
pub mod json;
mod made_rig;
mod options;
mod other_model;
mod passengers;
pub mod pb;
mod poses;
pub mod record;
mod rig;
mod transfer;
mod vertex_targets;
mod wrap;

pub use animate::{
    AnimateOrder, AnimationSummary, RootMotion, animate_options_from_json, animate_order, animation_totals,
    feet_message, held_nodes_message, of_rig, stage_frame, summary_frame,
};
pub use calls::{PoseCommit, SessionEdit, SessionPage, page_token, pose_commit, session_edit, session_page};
pub use create::{SessionOptions, open_options, session_options};
pub use crossings::{CrossingsOrder, crossings_order};
pub use edit::{edit, edit_name, edit_result};
pub use facts::{
    add_found_turns, followed_message, found_turns_message, handle_poses_message, origin_of, quality_message,
    session_message, warning_message, written_warnings,
};
pub use handles::{HandlePatch, handle_patch};
pub use handles::{handle_set, handle_set_message, region_message};
pub use made_rig::{MakeRigOrder, made_rig_message, make_rig_order};
pub use options::DeformOptions;
pub use passengers::{CarryOrder, carry_order};
pub use pliant_core::engine::Error;
pub use poses::{PoseKey, StreamLimits, StreamRequest, stream_request};
pub use poses::{change_poses, handle_pose, handle_pose_message, pose_changes};
pub use rig::{motion_rig, rig_from_json, rig_message};
pub use transfer::{TransferOrder, transfer_order, transfer_report};
