//! From a system and right-hand sides to solutions: cycles, outer iteration, starts and fallbacks.

pub(crate) mod advance;
mod coarse_fits;
pub(crate) mod criteria;
pub(crate) mod cycle;
pub(crate) mod fallback;
mod fine_fit;
mod fitted_pose;
pub(crate) mod frame_rows;
pub(crate) mod group;
mod inner;
pub(crate) mod iteration;
mod methods;
mod nearest_turn;
mod outer;
mod outer_state;
mod patches;
mod pose;
mod posed_residual;
pub(crate) mod problem;
mod quasi_newton;
mod recalled;
mod settled_pose;
mod start;
mod sweep;
pub(crate) mod workspace;

pub use self::frame_rows::{MapColumns, PoseRow};
pub use self::iteration::{IterationReport, SolveControl};
pub use self::methods::LinearEquations;
pub use self::pose::{PoseCriteria, PoseRows};
pub use self::workspace::Workspace;
