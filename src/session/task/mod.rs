//! The task of each session: the only one that touches its engine and its commits.

mod animate;
mod commands;
mod edit;
mod keep_commit;
mod recalled_pose;
pub(super) mod session_task;
mod step_out;
mod stream_turn;
