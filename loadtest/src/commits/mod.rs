//! `loadtest commits`: what it costs that commits outlive the server.
//!
//! The same poses are committed, and dragged, on servers that keep their sessions in memory, in SQLite and in PostgreSQL, in turns, in
//! one run: what else the machine does falls on all of them.

mod args;
pub(crate) mod command;
mod measured_place;
mod report;

pub(crate) use args::CommitsArgs;
