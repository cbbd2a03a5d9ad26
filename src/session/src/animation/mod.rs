//! Animations: a clip drives a session's model, and its frames go out in order.
//!
//! The session's task prepares an animation and is free again; what was prepared shares the model's structures and changes nothing
//! of the session's. A task of its own then solves frame by frame. It holds a compute slot for one frame at a time, so that
//! poses of other streams take their turn in between, and it goes on only while the reader has room for a frame.

pub(super) mod animation_task;
pub(super) mod frame_outbox;

pub(super) use animation_task::AnimationTask;
