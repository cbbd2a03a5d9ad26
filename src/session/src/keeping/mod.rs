//! Sessions with a store: their commits are kept before they are acknowledged, idle ones leave memory, and all come back when they are
//! asked for.

pub(super) mod heartbeat;
pub(super) mod kept_session;
pub(super) mod lease_watch;
pub(super) mod reopen;
pub(super) mod replay;
pub(super) mod sweep;
