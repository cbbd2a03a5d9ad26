//! The solver bench: systems in the peers' file format, what the solver takes for them, and the whole pipeline timed.
//!
//! Owns the files and the clock. What is measured is reached through public functions of the library only.

mod clock;
mod companion;
mod cycles;
pub(crate) mod edits;
pub(crate) mod export;
mod figures;
mod files;
mod free;
mod matrix;
mod memory;
pub(crate) mod pipeline;
mod problem;
pub(crate) mod solver;
mod subdivide;
mod whole;
