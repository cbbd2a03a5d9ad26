//! The calls of all transports: a session's handles, poses, commits and edits, asked for by tenant and id.

mod animate;
mod callers;
pub(super) mod command;
mod commits;
pub(super) mod create;
mod drain;
mod edit;
pub(super) mod handle_change;
pub(super) mod idempotency;
pub(super) mod manager;
pub(super) mod model_opening;
mod placement;
mod recorded_answer;
pub(super) mod session_places;
mod shape;
pub(super) mod shared_keys;
