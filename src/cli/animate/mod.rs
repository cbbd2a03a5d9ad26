//! `pliant animate`: a clip drives a model, frame by frame.
//!
//! [`command`] reads arguments and runs; [`output`] names the outputs. [`numbered`] writes each frame as a model. For
//! one file, [`gathered`] collects frames in a partial file ([`gathered`]), so that a stopped animation can go on,
//! and then writes a point cache or a GLB ([`crate::engine::Animation::write_clip`] makes it). [`pictures`] draws frames ([`pictures`]),
//! with another method's shapes beside them ([`pictures`]).

mod command;
mod gathered;
mod numbered;
mod output;
mod pictures;
mod play;

pub(super) use command::{AnimateArgs, run_animate};
