//! The calls of all transports: a session's handles, poses, commits and edits, asked for by tenant and id.

pub(super) mod command;
mod commits;
pub(super) mod create;
mod drain;
pub(super) mod idempotency;
pub(super) mod manager;
pub(super) mod model_opening;
mod shape;
pub(super) mod shared_keys;
