//! `pliant animate`: a clip drives a model, frame by frame.
//!
//! [`command`] reads arguments and runs, [`output`] tells where frames go. Numbered models are written as they come
//! ([`numbered`]); what becomes one file is kept in a partial file beside it first ([`frames_file`], [`gathered`]), so that a
//! stopped animation can go on, and then written as a point cache or as a GLB ([`crate::batch`] makes it).
//! Some become a picture ([`picture_args`], [`pictures`]), with another method's shapes beside them ([`linear_blend`]).

mod command;
mod frames_bar;
mod frames_file;
mod gathered;
mod linear_blend;
mod numbered;
mod output;
mod picture_args;
mod pictures;
mod taken_frames;

pub(super) use command::{AnimateArgs, run_animate};
