//! `pliant animate`: a clip drives a model, frame by frame.
//!
//! [`command`] reads arguments and runs, [`output`] tells where frames go. Numbered models are written as they come
//! ([`numbered`]); what becomes one file is kept in a partial file beside it first ([`frames_file`], [`gathered`]), so that a
//! stopped animation can go on, and then written as a point cache or as a GLB ([`crate::batch`] makes it).
//! Some become a picture ([`pictures`]).

mod command;
mod frames_bar;
mod frames_file;
mod gathered;
mod numbered;
mod output;
mod pictures;
mod taken_frames;

pub(super) use command::{AnimateArgs, run_animate};
