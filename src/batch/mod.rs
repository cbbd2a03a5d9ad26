//! Runs a declarative job in process: opens a model, sets handles, solves and edits step by step, writes the result.

mod run;

pub use run::{BatchOutcome, inspect, pose_steps, run, unmet_expectations};
