//! The declarative request: handles, poses and options as messages, their JSON, and a bench that runs them in process.
//!
//! Everything that a client can ask is a message of [`pb`]; this floor checks it, resolves regions to vertices and calls
//! the engine. It knows no session, no connection and no clock.

mod carry;
mod check;
mod create;
mod delta;
mod derived;
mod edit;
mod error;
mod foundation;
pub mod frames;
mod handles;
mod interior;
pub mod json;
mod operation;
mod origins;
pub mod pb;
mod posing;
mod quality;
mod region;
mod run;
mod trail;
mod workbench;

pub use check::Settings;
pub use edit::{EditOrder, EditOutcome};
pub use error::Error;
pub use posing::{Mode, Solved, Watch};
pub use run::{Outcome, edit_name, expectations, inspect, pose_steps, run};
pub use trail::Trail;
pub use workbench::{Limits, Poses, Workbench};
