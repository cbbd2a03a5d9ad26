//! The wire: messages of the schema, their JSON, and what they mean as values of [`crate::engine`].
//!
//! Everything that a client can ask is a message of [`pb`]. This module is the only one that checks what clients send; a
//! refusal names the field as clients write it. It knows no session, no connection and no clock.

mod check;
mod create;
mod edit;
mod edit_kind;
mod error;
mod expect;
mod facts;
pub mod frames;
mod handle_patch;
mod handles;
pub mod json;
mod options;
pub mod pb;
mod poses;

pub use create::open_options;
pub use edit::{edit, edit_name, edit_result};
pub use edit_kind::edit_kind_name;
pub use error::Error;
pub use facts::{quality_message, session_message, warning_message};
pub use handle_patch::{HandlePatch, handle_patch};
pub use handles::{handle_set, handle_set_message, region_message};
pub use options::DeformOptions;
pub use poses::{
    PoseEntry, change_poses, check_pose_size, handle_pose, handle_pose_message, pose_changes, pose_entries,
};
