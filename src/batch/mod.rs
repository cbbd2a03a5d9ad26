//! Runs a declarative job in process: opens a model, sets handles, solves and edits step by step, writes the result.

mod riders;
mod run;

pub use riders::CarriedFile;
pub use run::{BatchOutcome, inspect, pose_steps, run, unmet_expectations};
