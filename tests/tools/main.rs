//! The command line as scripts meet it, and what holds the source in shape.

mod animate;
mod base_colours;
mod check;
mod cli;
mod followed;
mod inspections;
mod named_files;
mod outputs;
mod pages;
mod render;
mod shading;
mod source;
#[path = "../support/mod.rs"]
mod support;
mod sweep;
