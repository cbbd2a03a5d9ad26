//! The whole pipeline, timed stage by stage: from a model to its first frame, and from an edit to the next frame.

pub(crate) mod edits;
pub(crate) mod first_frame;
pub(crate) mod fit_energies;
pub(crate) mod frame;
mod graph_stages;
mod pass_clock;
pub(crate) mod wire;
