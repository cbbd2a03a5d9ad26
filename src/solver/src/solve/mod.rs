//! From a system and right-hand sides to solutions: cycles, outer iteration, starts and fallbacks.

pub(crate) mod advance;
mod coarse_fits;
pub(crate) mod cycle;
pub(crate) mod fallback;
mod fitted_pose;
pub(crate) mod frame_rows;
pub(crate) mod group;
mod inner;
mod methods;
mod outer;
mod patches;
mod pose;
pub(crate) mod problem;
mod solution_subspace;
mod start;
mod sweep;

pub use self::frame_rows::{MapColumns, PoseRow};
pub use self::group::{IterationReport, SolveControl, StoppingCriteria, Workspace};
pub use self::pose::{PlaceRows, PoseEquations, PoseRows};
pub use self::problem::LinearEquations;
