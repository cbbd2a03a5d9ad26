//! The command line as scripts meet it, and what holds the source in shape.

mod animate;
mod architecture;
mod base_colours;
mod book;
mod check;
mod cli;
mod failures;
mod floors;
mod followed;
mod images;
mod inspections;
mod named_files;
mod outputs;
mod parts;
mod program;
mod render;
mod source;
#[path = "../support/mod.rs"]
mod support;
mod sweep;
