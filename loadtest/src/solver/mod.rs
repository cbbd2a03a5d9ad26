//! The solver alone: systems in the peers' file format, and what the solver takes for them.
//!
//! What is measured is reached through public functions of the library only.

pub(crate) mod command;
mod companion;
pub(crate) mod export;
mod free_system;
mod full_system;
mod matrix;
mod memory;
mod number_file;
mod paper_cycles;
mod problem;
mod ready;
mod work_unit;
