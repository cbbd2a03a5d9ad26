//! The task of each session: the only one that touches its engine and its commits.

pub(super) mod adopted_parts;
mod commands;
mod keep_commit;
mod look;
pub(super) mod session_task;
mod stream_turn;
