//! The task of each session: the only one that touches its engine and its commits.

mod animate;
mod commands;
mod edit;
pub(super) mod session_task;
mod stream_turn;
