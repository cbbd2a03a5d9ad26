//! Runs a declarative job in process: opens a model, sets handles, solves and edits step by step, writes the result.

mod inspect;
mod riders;
mod run;

pub use inspect::{ClipContents, MOST_NODES_TOLD, ModelContents, SkinContents, contents_of, inspect, inspect_contents};
pub use riders::CarriedFile;
pub use run::{BatchOutcome, BatchOutput, StepTaker, pose_steps, run, run_and_write, unmet_expectations};
