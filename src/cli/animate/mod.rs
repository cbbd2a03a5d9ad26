//! `pliant animate`: a clip drives a model, frame by frame.
//!
//! [`command`] reads arguments and runs; [`output`] names the outputs. [`numbered`] writes each frame as a model. For
//! one file, [`gathered`] collects frames in a partial file ([`frames_file`]), so that a stopped animation can go on,
//! and then writes a point cache or a GLB ([`crate::engine::Animation::write_clip`] makes it). [`pictures`] draws frames ([`picture_args`]),
//! with another method's shapes beside them ([`linear_blend`]).

mod command;
mod frames_bar;
mod frames_file;
mod gathered;
mod linear_blend;
mod numbered;
mod output;
mod picture_args;
mod pictures;
mod play;
mod taken_frames;

pub(super) use command::{AnimateArgs, run_animate};
