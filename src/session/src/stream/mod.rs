//! Interactive deform streams: poses in, frames out.
//!
//! A request goes into a mailbox, waits there as a pose, is solved by the session's task, and leaves as a frame that is
//! packed when the transport asks for it.

pub(super) mod ends;
pub(super) mod frame_window;
pub(super) mod mailbox;
pub(crate) mod waiting_poses;
