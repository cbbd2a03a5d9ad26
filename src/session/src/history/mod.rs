//! The ordered commits of a session, and the engine that makes their shapes.

pub(super) mod commit_history;
pub(super) mod loaded_deformer;
pub(super) mod session_state;
