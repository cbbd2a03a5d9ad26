//! The declarative request: handles, poses and options as messages, their JSON, and a bench that runs them in process.
//!
//! Everything that a client can ask is a message of [`pb`]; this floor checks it, resolves regions to vertices and calls
//! the engine. It knows no session, no connection and no clock.

mod carry;
mod check;
mod create;
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
mod quality;
mod region;
mod run;
mod workbench;

pub use check::Settings;
pub use edit::{EditOrder, EditOutcome, Trail};
pub use error::Error;
pub use run::{Outcome, Stage, edit_name, expectations, inspect, pose_steps, run};
pub use workbench::{Limits, Mode, Poses, Solved, Watch, Workbench};
